"""Tables of poses: one row an image or session, divided by any sign, with a header or without."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from reprlib import repr as brief
from typing import Literal, NoReturn

from servoscope.errors import DataSetError, InvalidInputError
from servoscope.formats.conventions import (
    CONVENTIONS,
    MATRIX_COLUMNS,
    ConventionOptions,
    PoseConvention,
)
from servoscope.formats.images import IMAGE_ENDINGS
from servoscope.formats.pose_text import other_separators, parse_numbers, parse_pose
from servoscope.formats.stamps import resolution
from servoscope.storage.reading import read_lines

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": " "}
"""What may divide the columns of a table, by name."""

_NAMES = ("name", "file", "filename", "file_name", "image", "image_name", "img", "path")
_TIMES = ("time", "timestamp", "stamp")
_ALIASES: dict[str, tuple[str, ...]] = {
    "tx": ("x", "px", "pos_x"),
    "ty": ("y", "py", "pos_y"),
    "tz": ("z", "pz", "pos_z"),
}
_ALIASES |= {f"q{axis}": (f"q_{axis}", f"quat_{axis}") for axis in "xyzw"}
_UNIT = re.compile(r"^(.*?)(?:\s*[\[(](mm|m|deg|rad|°|)[\])]|_(mm|deg|rad))$")
_IN_BRACKETS = re.compile(r"p?[\[({]*([-+.,\deE]*\d[-+.,\deE]*)[\])}]*")  # as p[0.1,0.2,...]
_LAST_ROW = ("0", "0", "0", "1")


@dataclass(frozen=True, kw_only=True)
class TableOptions(ConventionOptions):
    """What a user says of poses in tables and text files, besides what holds for all numbers.

    Parameters
    ----------
    name_column, time_column : str, optional
        Name of the column that names the images, and of that of the times [s], or its number
        from 1; by default usual names are known.
    delimiter : str, optional
        What divides the columns: comma, semicolon, tab, bar, space, or a sign; by default what the
        first line has.
    decimal : {"point", "comma"}
        How decimals are written.

    Examples
    --------
    >>> TableOptions(rotation="kuka-abc", delimiter="tab").length_unit
    'mm'
    """

    name_column: str | None = None
    time_column: str | None = None
    delimiter: str | None = None
    decimal: Literal["point", "comma"] = "point"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delimiter is not None and len(DELIMITERS.get(self.delimiter, self.delimiter)) != 1:
            raise InvalidInputError(
                f"delimiter must be one of {', '.join(DELIMITERS)}, or one sign, got "
                f"{self.delimiter!r}."
            )


@dataclass(frozen=True)
class PoseRow:
    """A row of a table.

    Parameters
    ----------
    where : str
        File and line, for errors.
    name : str, optional
        Of the image or session, where the table names them.
    numbers : list of float, optional
        Of the pose; None if they are unusable and left out.
    time : float, optional
        As it is written.
    session : str, optional
    step : float
        In which the time is written.
    """

    where: str
    name: str | None
    numbers: list[float] | None
    time: float | None = None
    session: str | None = None
    step: float = 0.0


@dataclass(frozen=True)
class _Layout:
    """Which cell of a row is what, counting from 0."""

    delimiter: str
    n_cells: int
    convention: PoseConvention
    pose: tuple[int, ...]
    name: int | None
    time: int | None = None
    session: int | None = None

    @property
    def used(self) -> set[int]:
        found = {*self.pose, self.name, self.time, self.session}
        return {place for place in found if place is not None}


def read_pose_table(
    path: Path, options: TableOptions, key: str = "name"
) -> tuple[PoseConvention, list[PoseRow]]:
    """The convention that a table's poses are written in, and its rows.

    A header names the columns, in any order. Without one, columns are those of the convention in
    their order, and the one that is no number, if any, is the name. Columns are divided by what the
    first line has: semicolons, tabs, bars, commas, or else spaces, between which a name may have
    gaps if it comes first or last.

    Parameters
    ----------
    path : Path
    options : TableOptions
    key : {"name", "session", "time"}
        What the rows are of: images, sessions, or moments.

    Raises
    ------
    DataSetError
        If the table is not what the options say. The message names the line.
    """
    rows, convention = [], options.convention or CONVENTIONS["xyzw"]
    of_header = partial(_layout_of_header, path=path, options=options, key=key)
    of_row = partial(_layout_of_row, options=options, key=key)
    wanted = ",".join(_wanted(options, key))
    for where, line, layout in _rows(path, options, of_header, of_row, _is_header, wanted):
        rows.append(_read_row(where, line, layout, options))
        convention = layout.convention
    return convention, rows


def read_times(path: Path, options: TableOptions) -> list[PoseRow]:
    """Names and times of images, in a table with a header or with these two columns.

    Raises
    ------
    DataSetError
        If a line has no name or no time. The message names the line.
    """
    rows = []
    of_header = partial(_times_of_header, path=path, options=options)
    for where, line, layout in _rows(
        path, options, of_header, _times_of_row, _has_no_number, "name,time"
    ):
        cells = _cells_of_row(line, layout, where)
        if len(cells) != layout.n_cells or layout.name is None or layout.time is None:
            _refuse_length(cells, layout.n_cells, where)
        text = _with_point(cells[layout.time], options)
        time, step = parse_numbers([text], ["time"], where)[0], resolution([text], where)
        rows.append(PoseRow(where, cells[layout.name], None, time, None, step))
    if not rows:
        raise DataSetError(f"{path} names no image; it must hold their names and times.")
    return rows


def read_pose_file(path: Path, convention: PoseConvention, options: TableOptions) -> list[float]:
    """The numbers of the one pose that a file holds, however they are divided into lines.

    Raises
    ------
    DataSetError
        If they are not as many as the convention has, or no pose.
    """
    lines = [line for line in read_lines(path, DataSetError) if not line.lstrip().startswith("#")]
    signs = r"[\s;|\[\]]+" if options.decimal == "comma" else r"[\s,;|\[\]]+"
    texts = [text for text in re.split(signs, " ".join(lines)) if text]
    if len(texts) not in _counts(convention):
        raise DataSetError(
            f"{path} must hold {_count_words(convention)} ({convention.meaning}), got "
            f"{len(texts)}; check --rotation."
        )
    return _parse(texts, convention, str(path), options)


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Where each line that holds something stands, and the line."""
    for number, line in enumerate(read_lines(path, DataSetError), start=1):
        if line := line.strip(" \r\n"):
            yield f"{path}, line {number}", line


def _rows(
    path: Path,
    options: TableOptions,
    of_header: Callable[..., _Layout | None],
    of_row: Callable[..., _Layout],
    is_header: Callable[[list[str]], bool],
    wanted: str,
) -> Iterator[tuple[str, str, _Layout]]:
    """Where each row stands, the row, and its layout, which the first line or the header gives.

    A header may stand in a comment, if it names all that is wanted.
    """
    layout = None
    for where, line in _lines(path):
        is_comment = line.startswith("#")
        if layout is None:
            delimiter = _delimiter(line, options)
            cells = _split(line.lstrip("#").strip(), delimiter, where)
            if is_header(cells):
                layout = of_header(cells, delimiter, is_comment=is_comment)
                continue
            if is_comment:
                continue
            layout = of_row(cells, delimiter, where)
        if not is_comment:
            yield where, line, layout
    if layout is None:
        raise DataSetError(f"{path} is empty; it must begin with the header {wanted}.")


def _times_of_header(
    cells: list[str], delimiter: str, path: Path, options: TableOptions, is_comment: bool
) -> _Layout | None:
    header = [_plain(cell)[0] for cell in cells]
    name, time = (
        next((header.index(known) for known in usual if known in header), None)
        for usual in (_NAMES, _TIMES)
    )
    if name is None:
        name = _name_place(header, options, "name", path)
    if time is None:  # the option may be meant for the poses alone
        time = _time_place(header, options, path)
    if (name is None or time is None) and not is_comment:
        raise DataSetError(
            f"{path}: the header must hold name,time, but {brief(','.join(cells))} lacks "
            f"{'name' if name is None else 'time'}; name other columns with --name-column and "
            "--time-column."
        )
    if name is None or time is None:
        return None
    return _Layout(delimiter, len(cells), CONVENTIONS["xyzw"], (), name, time)


def _times_of_row(cells: list[str], delimiter: str, where: str) -> _Layout:
    """Two columns without a header: the number is the time."""
    if len(cells) < 2 or (len(cells) > 2 and delimiter != " "):
        raise DataSetError(f"{where}: must be a name and a time, got {len(cells)} cells.")
    time = 0 if _is_number(cells[0]) else 1
    return _Layout(delimiter, 2, CONVENTIONS["xyzw"], (), 1 - time, time)


def _delimiter(line: str, options: TableOptions) -> str:
    if options.delimiter is not None:
        return DELIMITERS.get(options.delimiter, options.delimiter)
    return next((sign for sign in ";\t|," if sign in line.strip()), " ")


def _split(line: str, delimiter: str, where: str) -> list[str]:
    if delimiter.isspace() and delimiter != "\t":
        cells = [quoted or bare for quoted, bare in re.findall(r'"([^"]*)"|(\S+)', line)]
    else:
        try:
            cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
        except csv.Error as error:
            raise DataSetError(f"{where}: not CSV ({error}).") from error
    return [found[1] if (found := _IN_BRACKETS.fullmatch(cell)) else cell for cell in cells]


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _is_header(cells: list[str]) -> bool:
    """Whether cells are names of columns: of those of a row most are numbers."""
    n_numbers = sum(map(_is_number, cells))
    return n_numbers < len(cells) / 2 if len(cells) > 1 else not n_numbers


def _has_no_number(cells: list[str]) -> bool:
    return not any(map(_is_number, cells))


def _plain(column: str) -> tuple[str, str]:
    """Name of a column in small letters, and the unit that it gives."""
    column = column.strip().lower()
    if found := _UNIT.match(column):
        unit = found[2] or found[3] or ""
        return found[1].strip(), "deg" if unit == "°" else unit
    return column, ""


def _wanted(options: TableOptions, key: str) -> list[str]:
    return [key, *(options.convention or CONVENTIONS["xyzw"]).columns]


def _layout_of_header(
    cells: list[str],
    delimiter: str,
    path: Path,
    options: TableOptions,
    key: str,
    is_comment: bool = False,
) -> _Layout | None:
    header = [_plain(cell)[0] for cell in cells]
    convention = options.convention or CONVENTIONS["xyzw"]
    if options.convention is None and options.columns is not None and not is_comment:
        _refuse_header(path, cells, options, key, _SAY_ROTATION)
    try:
        name = _name_place(header, options, key, path)
        pose = _pose_places(header, convention, options, path)
        time = _time_place(header, options, path)
    except DataSetError:
        if is_comment:
            return None
        raise
    missing = ["session"] if key == "session" and name is None else []
    missing += ["time"] if key == "time" and time is None else []
    missing += [c for c, place in zip(convention.columns, pose, strict=False) if place is None]
    if missing and is_comment:
        return None
    if missing:
        hint = other_separators(cells[0]) if len(cells) == 1 else ""
        hint += "" if hint or options.convention else _SAY_ROTATION
        _refuse_header(path, cells, options, key, f" lacks {', '.join(missing)}{hint}")
    layout = _Layout(
        delimiter,
        len(header),
        convention,
        tuple(place for place in pose if place is not None),
        name,
        time if time not in pose else None,
        header.index("session") if "session" in header and key != "session" else None,
    )
    repeated = sorted({header[place] for place in layout.used if header.count(header[place]) > 1})
    if repeated and options.columns is None:
        _refuse_header(path, cells, options, key, f" repeats {', '.join(repeated)}")
    _check_units([cells[place] for place in layout.pose], path, options, convention)
    return layout


def _place(column: str, header: list[str]) -> int | None:
    found = [name for name in (column, *_ALIASES.get(column, [])) if name in header]
    return header.index(found[0]) if found else None


def _name_place(header: list[str], options: TableOptions, key: str, path: Path) -> int | None:
    if options.name_column is not None and key == "name":
        return _named_place(options.name_column, header, len(header), path, "name_column")
    names = _NAMES if key == "name" else (key, *_NAMES)
    return next((header.index(name) for name in names if name in header), None)


def _time_place(header: list[str], options: TableOptions, path: Path) -> int | None:
    if options.time_column is not None:
        return _named_place(options.time_column, header, len(header), path, "time_column")
    return next((header.index(name) for name in _TIMES if name in header), None)


def _pose_places(
    header: list[str], convention: PoseConvention, options: TableOptions, path: Path
) -> list[int | None]:
    if options.columns is None:
        return [_place(column, header) for column in convention.columns]
    named = options.columns.split(",")
    if len(named) not in _counts(convention):
        raise DataSetError(
            f"--columns must name {_count_words(convention)} ({','.join(convention.columns)}), got "
            f"{len(named)} ({options.columns})."
        )
    return [_named_place(name, header, len(header), path, "columns") for name in named]


def _named_place(name: str, header: list[str], n_cells: int, path: Path, option: str) -> int:
    """The place of a column that an option names, or gives the number of, counting from 1."""
    name = name.strip().lower()
    if name in header:
        return header.index(name)
    if name.isdecimal() and 1 <= int(name[:6]) <= n_cells:
        return int(name) - 1
    what = f"its header is {brief(','.join(header))}" if header else f"it has {n_cells} columns"
    raise DataSetError(
        f"{path} has no column {brief(name)}, which --{option.replace('_', '-')} names: {what}."
    )


_SAY_ROTATION = (
    "; other rotations than quaternions are said with --rotation "
    f"({', '.join(CONVENTIONS)}, or an order of axes)"
)


def _refuse_header(
    path: Path, cells: list[str], options: TableOptions, key: str, problem: str
) -> NoReturn:
    raise DataSetError(
        f"{path}: the header must hold {','.join(_wanted(options, key))}, but "
        f"{brief(','.join(cells))}{problem}. Other names are given with --columns."
    )


def _check_units(
    names: list[str], path: Path, options: TableOptions, convention: PoseConvention
) -> None:
    """Check that units in the names of columns are those that are read."""
    angle = options.angle_unit or convention.angle_unit
    for name in names:
        unit = _plain(name)[1]
        for known, used, option in (
            (("m", "mm"), options.length_unit, "--units"),
            (("deg", "rad"), angle, "--angle-unit"),
        ):
            if unit in known and used is not None and unit != used:
                raise DataSetError(
                    f"{path}: the header says {name.strip()!r}, but {used} are read; say {option} "
                    f"{unit}, or mend the header."
                )


def _layout_of_row(
    cells: list[str], delimiter: str, where: str, options: TableOptions, key: str
) -> _Layout:
    """The layout of a table without a header, from its first row."""
    convention, path = options.convention, Path(where.rsplit(", line ", 1)[0])
    if convention is None:
        raise DataSetError(
            f"{where}: there is no header, so that the order of the columns must be said with "
            f"--rotation ({', '.join(CONVENTIONS)}, or an order of axes)."
        )
    counts, with_gaps = _counts(convention), delimiter == " "
    numeric = [_is_number(cell) for cell in cells]
    if key == "time":
        return _layout_of_log(cells, delimiter, where, options, convention)
    if options.columns is not None or options.name_column is not None:
        name = None
        if options.name_column is not None and key == "name":
            name = _named_place(options.name_column, [], len(cells), path, "name_column")
        elif not all(numeric):
            name = numeric.index(False)
        if options.columns is not None:
            pose = _pose_places([""] * len(cells), convention, options, path)
            found = tuple(place for place in pose if place is not None)
            return _Layout(delimiter, len(cells), convention, found, name)
        pose_cells = [i for i in range(len(cells)) if i != name]
        if len(pose_cells) in counts:
            return _Layout(delimiter, len(cells), convention, tuple(pose_cells), name)
    for n in sorted(counts, reverse=True):
        if len(cells) == n and all(numeric) and key == "name":
            return _Layout(delimiter, n, convention, tuple(range(n)), None)
        is_long = len(cells) > n if with_gaps else len(cells) == n + 1
        if is_long and all(numeric[-n:]) and not numeric[0]:
            return _Layout(delimiter, n + 1, convention, tuple(range(1, n + 1)), 0)
        if is_long and all(numeric[:n]) and not numeric[-1]:
            return _Layout(delimiter, n + 1, convention, tuple(range(n)), n)
    raise DataSetError(
        f"{where}: must be a {key} and {_count_words(convention)} ({','.join(convention.columns)})"
        f", got {len(cells)} cells, {sum(numeric)} of them numbers; say which they are with "
        "--columns and --name-column, or write a header."
    )


def _layout_of_log(
    cells: list[str], delimiter: str, where: str, options: TableOptions, convention: PoseConvention
) -> _Layout:
    """The layout of a log without a header: time and pose, if nothing else is said."""
    path, n = Path(where.rsplit(", line ", 1)[0]), len(cells)
    time = 0
    if options.time_column is not None:
        time = _named_place(options.time_column, [], n, path, "time_column")
    pose = [i for i in range(n) if i != time]
    if options.columns is not None:
        named = _pose_places([""] * n, convention, options, path)
        pose = [place for place in named if place is not None]
    if len(pose) not in _counts(convention):
        raise DataSetError(
            f"{where}: must be a time and {_count_words(convention)} "
            f"({','.join(convention.columns)}), got {n} cells; say which they are with --columns "
            "and --time-column, or write a header."
        )
    return _Layout(delimiter, n, convention, tuple(pose), None, time)


def _read_row(where: str, line: str, layout: _Layout, options: TableOptions) -> PoseRow:
    cells = _cells_of_row(line, layout, where)
    if len(cells) != layout.n_cells:
        if len(cells) > layout.n_cells or not options.skip_bad:
            _refuse_length(cells, layout.n_cells, where)
        name = cells[layout.name] if layout.name is not None and layout.name < len(cells) else None
        return PoseRow(where, name, None)
    if layout.name is None and layout.time is None:
        _check_nameless(cells, where)
    name = cells[layout.name] if layout.name is not None else None
    session = cells[layout.session] if layout.session is not None else None
    try:
        numbers = _parse([cells[place] for place in layout.pose], layout.convention, where, options)
        time, step = None, 0.0
        if layout.time is not None:
            text = _with_point(cells[layout.time], options)
            time, step = parse_numbers([text], ["time"], where)[0], resolution([text], where)
    except DataSetError:
        if not options.skip_bad:
            raise
        return PoseRow(where, name, None, None, session)
    return PoseRow(where, name, numbers, time, session, step)


def _check_nameless(cells: list[str], where: str) -> None:
    """Check that no cell names an image: rows without names go by the order of the images."""
    named = [i for i, cell in enumerate(cells) if cell.lower().endswith(IMAGE_ENDINGS)]
    if named:
        raise DataSetError(
            f"{where}: column {named[0] + 1} seems to name the images ({brief(cells[named[0]])}), "
            f"but is not called name, file or image; say --name-column {named[0] + 1}."
        )


def _cells_of_row(line: str, layout: _Layout, where: str) -> list[str]:
    """The cells of a row; between spaces, the name keeps its gaps if it comes first or last."""
    cells = _split(line, layout.delimiter, where)
    while len(cells) > layout.n_cells and not cells[-1]:
        cells.pop()
    n_gaps = len(cells) - layout.n_cells
    if layout.delimiter != " " or n_gaps <= 0 or '"' in line:
        return cells
    words = list(re.finditer(r"\S+", line))
    if layout.name == 0:
        return [line[: words[n_gaps].end()], *cells[n_gaps + 1 :]]
    if layout.name == layout.n_cells - 1:
        return [*cells[: layout.name], line[words[layout.name].start() :]]
    return cells


def _parse(
    texts: list[str], convention: PoseConvention, where: str, options: TableOptions
) -> list[float]:
    texts = [_with_point(text, options) for text in texts]
    if convention.by_column:
        texts = [texts[4 * (i % 4) + i // 4] for i in range(16)]
    if convention.is_matrix and len(texts) == len(MATRIX_COLUMNS) + 4:
        last = parse_numbers(texts[-4:], [f"r4{i}" for i in range(1, 5)], where)
        if max(abs(a - float(b)) for a, b in zip(last, _LAST_ROW, strict=True)) > 1e-6:
            order = "row by row" if convention.by_column else "column by column"
            raise DataSetError(
                f"{where}: the last row of the matrix must be 0 0 0 1, got "
                f"{' '.join(f'{number:g}' for number in last)}; does it stand {order}? See "
                "--rotation."
            )
        texts = texts[:-4]
    return parse_pose(texts, convention, where, options.length_unit, options.angle_unit)


def _with_point(text: str, options: TableOptions) -> str:
    return text.replace(",", ".") if options.decimal == "comma" and "." not in text else text


def _counts(convention: PoseConvention) -> set[int]:
    """How many numbers a pose may have: the last row of a matrix may be left out."""
    n = len(convention.columns)
    return {n, n + 4} if convention.is_matrix and not convention.by_column else {n}


def _count_words(convention: PoseConvention) -> str:
    return f"{' or '.join(map(str, sorted(_counts(convention))))} numbers"


def _refuse_length(cells: list[str], n_cells: int, where: str) -> NoReturn:
    found = f"{len(cells)} cell{'s' * (len(cells) != 1)}"
    hint = other_separators(cells[0]) if len(cells) == 1 else ""
    if len(cells) > n_cells:
        hint = ": decimal commas, or a separator too many? Write decimals with a point"
    raise DataSetError(
        f"{where} has {found}, but the first line has {n_cells} columns{hint}; divide all lines "
        "alike."
    )
