import re

import numpy as np

from servoscope.poses import DOFS
from servoscope.study import paper

SYMBOLS = {r"\bar{x}": "x", r"\bar{y}": "y", "θ": "theta", "r_1": "r1", "r_2": "r2"}
SYMBOLS |= {"m_{00}": "m00", "S_x": "sx", "S_y": "sy"}


def numbers(line: str) -> list[float]:
    return [float(cell) for cell in line.split("\t")[1:]]


def our_name(symbol: str) -> str:
    """Our name of a feature, from the paper's LaTeX."""
    symbol = symbol.strip().strip("$")
    if match := re.fullmatch(r"e_\{?(\w+)\}?", symbol):
        return f"e_{int(match[1]):02d}" if match[1].isdigit() else "e_?"
    if match := re.fullmatch(r"PCI_\{([RT])_([xyz])\}", symbol):
        return f"pci_{match[1].lower()}{match[2]}"
    base, slice_ = re.fullmatch(r"(.+)\^\{(\d+)\}", symbol).groups()
    return f"{SYMBOLS[base]}_{slice_}"


def test_table_1_is_the_papers(paper_text):
    for family, label in zip(
        paper.FAMILIES, ("GM", "PCA", "PCI", "LFA (35 ev)", "LFA (85 ev)"), strict=True
    ):
        row = re.search(rf"^{re.escape(label)}\t.*$", paper_text, re.MULTILINE)[0]
        assert list(paper.TABLE1[family].values()) == numbers(row)


def test_table_2_is_the_papers(paper_text):
    lines = paper_text.splitlines()
    first = 1 + max(i for i, line in enumerate(lines) if line.startswith("R_z\t"))
    columns = np.array([line.split("\t") for line in lines[first : first + 24]]).T
    for dof, column in zip(("rz", "rx", "ry", "tz", "tx", "ty"), columns, strict=True):
        assert paper.table2(dof) == [our_name(symbol) for symbol in column]


def test_table_3_is_the_papers(paper_text):
    rms = numbers(re.search(r"^RMS error\t.*$", paper_text, re.MULTILINE)[0])
    sizes = numbers(re.search(r"^N features\t.*$", paper_text, re.MULTILINE)[0])
    assert [entry["rms"] for entry in paper.TABLE3.values()] == rms
    assert [entry["n_features"] for entry in paper.TABLE3.values()] == sizes


def test_every_published_ranking_has_24_different_features():
    for dof in DOFS:
        names = paper.table2(dof)
        assert len(names) == len(set(names)) == 24
