import re
from dataclasses import fields
from pathlib import Path

import pytest

from servoscope.formats import FORMATS, ImportOptions, read_folder

PAGE = (Path(__file__).parents[2] / "docs" / "importing.md").read_text(encoding="utf-8")


def test_the_page_names_every_option_and_no_other():
    flags = set(re.findall(r"(?<!\w)--([a-z][a-z-]+)", PAGE)) - {"help", "out"}
    options = {field.name for format_ in FORMATS.values() for field in fields(format_.options)}
    assert flags == {name.replace("_", "-") for name in options}


@pytest.mark.parametrize("name", FORMATS)
def test_the_page_shows_the_command_of_every_format(name):
    assert f"servoscope import {name} SRC OUT" in PAGE


def test_the_table_on_the_page_can_be_imported(pose_folder):
    table = re.search(r"```text\n(name,.*?)```", PAGE, re.DOTALL)[1]
    (pose_folder.path / "poses.csv").write_text(table)
    for i, name in enumerate(("left/0001.png", "left/0002.png")):
        pose_folder.write_image(name, pose_folder.images[i])
    data = read_folder(pose_folder.path, ImportOptions())
    assert data.times.tolist() == [12.4, 12.6]
