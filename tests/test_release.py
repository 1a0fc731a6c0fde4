"""What states a version states the same one."""

import re
from pathlib import Path

import servoscope

ROOT = Path(__file__).parents[1]


def test_citation_and_changelog_are_of_this_version() -> None:
    cited = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(), re.M))
    releases = re.findall(r"^## \[(\d.*)\] - (.*)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert (cited["version"], cited["date-released"]) == releases[0]
    assert cited["version"] == servoscope.__version__


def test_releases_of_the_changelog_stand_from_the_newest_on() -> None:
    changes = (ROOT / "CHANGELOG.md").read_text()
    releases = re.findall(r"^## \[([\d.]+)\] - (\d{4}-\d\d-\d\d)$", changes, re.M)
    assert len(releases) == len(re.findall(r"^## \[\d", changes, re.M)) >= 2
    ordered = [(tuple(map(int, number.split("."))), date) for number, date in releases]
    assert ordered == sorted(ordered, reverse=True)
