"""The commands and the imports of the documentation are such."""

import ast
import re
import shlex
from pathlib import Path

import pytest

import servoscope
from servoscope.cli import _asked_for, _cluster_options

ROOT = Path(__file__).parents[1]
TOP = ("README.md", "CONTRIBUTING.md")
PAGES = [*(ROOT / name for name in TOP), *sorted((ROOT / "docs").glob("*.md"))]
FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
RUN = re.compile(r"(\.venv/bin/)?(servoscope|python -m|pip) .*")
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def commands(text: str) -> list[str]:
    """Lines of shell, wherever they stand as blocks, and commands with arguments within lines."""
    blocks = [code for kind, code in FENCED.findall(text) if kind in ("sh", "console")]
    blocks += re.findall(r"^    (.*)$", text, re.MULTILINE)
    lines = [line.removeprefix("$ ") for block in blocks for line in block.splitlines()]
    steps = [step.strip() for line in lines for step in line.split("&&")]
    inline = re.findall(r"`([^`\n]*servoscope [^`\n]*--?[^`\n]*)`", FENCED.sub("", text))
    return [step for step in (*steps, *inline) if RUN.fullmatch(step)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_written_for_one_place_and_exist(page: Path) -> None:
    for command in commands(page.read_text(encoding="utf-8")):
        program, *arguments = shlex.split(command, comments=True)
        assert program.startswith(".venv/bin/"), command
        if program.endswith("/servoscope") and "--help" not in arguments:
            assert callable(_asked_for(_cluster_options(arguments)[1])), command


def test_there_are_commands_to_look_at() -> None:
    assert len([c for page in PAGES for c in commands(page.read_text(encoding="utf-8"))]) > 25


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tests_benchmarks_and_examples_that_are_named_are_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = set(re.findall(r"\b(?:tests|examples)/[\w/]+\.py", text))
    named |= {f"benchmarks/{name}.py" for name in re.findall(r"-m benchmarks (\w+)", text)}
    assert not [name for name in sorted(named) if not (ROOT / name).exists()]


def anchors(page: Path) -> set[str]:
    """What GitHub lets links to a page's headings end with."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in link:
            continue
        path, _, heading = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if heading and target.suffix == ".md":
            assert heading in anchors(target), link


def test_the_reference_has_every_public_name() -> None:
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^   (\w+)$", text, re.MULTILINE))
    assert listed == set(servoscope.__all__)


def python_of(page: Path) -> list[str]:
    """Blocks of Python in a page, or in what an example says of itself."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".md":
        return [code for kind, code in FENCED.findall(text) if kind == "python"]
    said = ast.get_docstring(ast.parse(text)) or ""
    return [re.sub(r"^    ", "", "\n".join(re.findall(r"^    .*$", said, re.M)), flags=re.M)]


@pytest.mark.parametrize("page", [*PAGES, *EXAMPLES], ids=lambda page: page.name)
def test_python_names_only_what_it_imports(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    for code in python_of(page):
        if code.startswith(".venv/bin/"):
            continue
        tree = ast.parse(code)
        imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
        known: dict[str, object] = {}
        exec(compile(ast.Module(imports, []), str(page), "exec"), known)  # noqa: S102
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                owner = node.value.id
                if owner in ("sv", "servoscope"):
                    assert owner in known, f"{owner} is not imported"
                    assert hasattr(known[owner], node.attr), node.attr
        if page in EXAMPLES:
            made = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)} - set(known)
            assigned = {
                n.id
                for n in ast.walk(tree)
                if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
            }
            assert made - assigned <= {"driver", "print"}
