"""What a program answered: the files in its folder of results, checked against the tasks."""

import csv
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO, TextIOWrapper
from math import isfinite
from os.path import lexists
from pathlib import Path
from typing import TypeVar

from pydantic import RootModel

from acquisition.printable import on_one_line
from acquisition.regular_files import LARGEST_DOCUMENT_BYTES
from analysis.benchmark._data_set import (
    FREQUENCIES,
    About,
    GivenAlignment,
    GivenThings,
    Places,
    PsfTruth,
    Shape,
    Track,
    document,
    file_bytes,
    grey_levels,
)
from analysis.errors import ResultsFileError
from simulation.arrays import Float32Array

PSF_NAME, ALIGNMENT_NAME, DETECTIONS_NAME = "psf.csv", "alignment.json", "detections.json"
THINGS_NAME = "things.json"
_ABOUT_NAME = "about.json"

_Answer = TypeVar("_Answer")

_ERROR_COLUMN = "mtf50_standard_error"
_MTF_COLUMNS = tuple(f"mtf_{name}" for name in FREQUENCIES)
_NEEDED = ("chart", "edge", "mtf50")
_HEAD_NEEDED = "the header must name chart, edge and mtf50, each column once"
_LONGEST_HEAD_BYTES = 10_000
_MOST_CY_PER_PX = 10.0
_MOST_CONTRAST = 100.0


class _Alignments(RootModel[dict[str, GivenAlignment]]):
    """alignment.json."""


class _Things(RootModel[dict[str, GivenThings]]):
    """things.json."""


class _Detections(RootModel[dict[str, Places]]):
    """detections.json."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenEdge:
    """What a program says of an edge: MTF50 in cycles/px, its standard error, and contrasts."""

    mtf50: float | None
    standard_error: float | None
    mtf: Mapping[str, float]


class ProgramFiles:
    """The folder of a program's results.

    Parameters
    ----------
    folder
        May hold an about.json with the program's name; else the folder's name is taken.

    Raises
    ------
    ResultsFileError
        If there is no such folder, or about.json is damaged.
    """

    def __init__(self, folder: Path) -> None:
        try:
            is_folder = folder.is_dir()
        except OSError:  # its name is too long to be one
            is_folder = False
        if not is_folder:
            raise ResultsFileError(
                f"{folder} is not a folder; name one with the files of a program's results",
                source=str(folder),
            )
        self.folder = folder
        path = folder / _ABOUT_NAME
        self.about = (
            document(file_bytes(path), path, About)
            if lexists(path)
            else About(name=on_one_line(folder.resolve().name)[:60] or "results")
        )

    def has(self, track: Track) -> bool:
        """Whether the program took part in a track."""
        return any(lexists(path) for path in self._paths(track))

    def documents(self) -> list[Path]:
        """The files of its answers that are no pictures."""
        names = (_ABOUT_NAME, PSF_NAME, ALIGNMENT_NAME, DETECTIONS_NAME, THINGS_NAME)
        return [path for name in names if lexists(path := self.folder / name)]

    def edges(self, truth: PsfTruth) -> dict[tuple[str, str], GivenEdge]:
        """Read psf.csv: what is said of each chart's edges.

        Raises
        ------
        ResultsFileError
            If a column, chart or edge is unknown, a row repeated, or a value is none.
        """
        path = self.folder / PSF_NAME
        found: dict[tuple[str, str], GivenEdge] = {}
        for line, row in _rows(path):
            chart, edge = row["chart"], row["edge"]
            if chart not in truth.charts:
                raise _refused(path, f"line {line}: there is no chart {_shown(chart)}")
            if edge not in truth.charts[chart].edges:
                raise _refused(path, f"line {line}: chart {chart} has no edge {_shown(edge)}")
            if (chart, edge) in found:
                raise _refused(path, f"line {line}: edge {edge} of {chart} has a row already")
            contrasts = {name: _number(path, line, row, f"mtf_{name}") for name in FREQUENCIES}
            found[chart, edge] = GivenEdge(
                mtf50=_number(path, line, row, "mtf50"),
                standard_error=_number(path, line, row, _ERROR_COLUMN),
                mtf={name: value for name, value in contrasts.items() if value is not None},
            )
        return found

    def alignments(self, tasks: Collection[str]) -> dict[str, GivenAlignment]:
        """Read alignment.json.

        Raises
        ------
        ResultsFileError
            If a task is unknown, or an answer is none.
        """
        return self._answers(ALIGNMENT_NAME, _Alignments, tasks)

    def things(self, tasks: Collection[str]) -> dict[str, GivenThings]:
        """Read things.json.

        Raises
        ------
        ResultsFileError
            If a task is unknown, or an answer is none.
        """
        return self._answers(THINGS_NAME, _Things, tasks)

    def detections(self, tasks: Collection[str]) -> dict[str, Places] | None:
        """Read detections.json; None where there is none.

        Raises
        ------
        ResultsFileError
            If a task is unknown, or a place is none.
        """
        if not lexists(self.folder / DETECTIONS_NAME):
            return None
        return self._answers(DETECTIONS_NAME, _Detections, tasks)

    def pictures(self, track: Track, tasks: Collection[str]) -> dict[str, Path]:
        """Return the pictures of a track, by task.

        Raises
        ------
        ResultsFileError
            If a file in the track's folder is no task's.
        """
        folder, known = self.folder / track, {f"{task}.tif": task for task in tasks}
        if not lexists(folder):
            return {}
        try:
            files = sorted(folder.iterdir())
        except OSError as error:
            raise _refused(folder, f"cannot be read: {error.strerror}") from error
        shown = [path for path in files if not path.name.startswith(".")]
        odd = next((path for path in shown if path.name not in known), None)
        if odd is not None:
            raise _refused(odd, f"there is no such task; the files of {folder} are TASK.tif")
        return {known[path.name]: path for path in shown}

    def _answers(
        self, name: str, model: type[RootModel[dict[str, _Answer]]], tasks: Collection[str]
    ) -> dict[str, _Answer]:
        """Read a document that has an answer to each task, and know the tasks."""
        path = self.folder / name
        found = document(file_bytes(path, LARGEST_DOCUMENT_BYTES), path, model).root
        odd = next((task for task in found if task not in tasks), None)
        if odd is not None:
            raise _refused(path, f"there is no task {_shown(odd)}")
        return found

    def _paths(self, track: Track) -> tuple[Path, ...]:
        names = {
            "psf": (PSF_NAME,),
            "simulation": ("simulation",),
            "alignment": (ALIGNMENT_NAME,),
            "changes": ("changes", DETECTIONS_NAME),
            "things": (THINGS_NAME,),
        }
        return tuple(self.folder / name for name in names[track])


def given_levels(path: Path, shape: Shape) -> Float32Array:
    """Read a picture that a program wrote.

    Raises
    ------
    ResultsFileError
        If it is damaged, or of another shape.
    """
    return grey_levels(file_bytes(path), path, shape)


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Lines of a table with their numbers, the first after the header 2."""
    data = file_bytes(path, LARGEST_DOCUMENT_BYTES)
    # Read piece by piece: a text as a whole takes four bytes a character.
    text = TextIOWrapper(BytesIO(data), encoding="utf-8-sig", newline="")
    rows = csv.reader(text, strict=True)
    try:
        first = data[:_LONGEST_HEAD_BYTES]
        if len(data) > len(first) and b"\n" not in first and b"\r" not in first:
            raise _refused(path, _HEAD_NEEDED)
        head = [name.strip() for name in next(rows, [])]
        _check_head(path, head)
        for row in rows:
            if not row:
                continue
            if len(row) != len(head):
                raise _refused(path, f"line {rows.line_num}: {len(row)} cells, not {len(head)}")
            cells = (cell.strip() for cell in row)
            yield rows.line_num, dict(zip(head, cells, strict=True))
    except UnicodeDecodeError as error:
        raise _refused(path, "is not UTF-8 text") from error
    except csv.Error as error:
        raise _refused(path, f"line {rows.line_num}: {error}") from error


def _check_head(path: Path, head: list[str]) -> None:
    known = {*_NEEDED, _ERROR_COLUMN, *_MTF_COLUMNS}
    odd = next((name for name in head if name not in known), None)
    if odd is not None:
        raise _refused(path, f"unknown column {_shown(odd)}; known are {', '.join(sorted(known))}")
    if len(set(head)) < len(head) or not set(_NEEDED) <= set(head):
        raise _refused(path, _HEAD_NEEDED)


def _number(path: Path, line: int, row: Mapping[str, str], column: str) -> float | None:
    """The number in a cell; None where the cell or the column is empty."""
    cell = row.get(column, "")
    if not cell:
        return None
    most = _MOST_CONTRAST if column in _MTF_COLUMNS else _MOST_CY_PER_PX
    least = -most if column in _MTF_COLUMNS else 0.0
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not isfinite(value) or not least <= value <= most:
        raise _refused(
            path,
            f"line {line}: {column} is {_shown(cell)}, expected a number from {least:g} to "
            f"{most:g}, or an empty cell where nothing was measured",
        )
    return value


def _shown(text: str) -> str:
    return repr(on_one_line(text)[:60])


def _refused(path: Path, problem: str) -> ResultsFileError:
    return ResultsFileError(f"{path}: {problem}", source=str(path))
