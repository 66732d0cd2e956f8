"""Files of a data set or a program that cannot be used: each is named, with the remedy."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from analysis.errors import ResultsFileError
from tests.analysis.benchmark.hand_made_set import (
    COLS,
    ROWS,
    everything,
    write_json,
    write_picture,
    write_table,
)

Spoil = Callable[[Path], object]
SINGULAR = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
TOO_FEW = [[0.0, 0.0]]


def answer(**content: object) -> Spoil:
    return lambda program: write_json(program, "alignment.json", {"p0": content})


def text(name: str, content: str) -> Spoil:
    return lambda program: (program / name).write_text(content)


def rows(*lines: str, head: str = "chart,edge,mtf50") -> Spoil:
    return lambda program: write_table(program, list(lines), head)


def picture(track: str, task: str, levels: object) -> Spoil:
    return lambda program: write_picture(program, track, task, np.asarray(levels))


def infinite() -> object:
    levels = np.zeros((ROWS, COLS))
    levels[3, 3] = np.inf
    return levels


FAULTS: dict[str, tuple[Spoil, str, str]] = {
    "chart": (rows("z,0,0.2"), "psf.csv", "line 2: there is no chart 'z'"),
    "edge": (rows("a,7,0.2"), "psf.csv", "no edge '7'"),
    "row twice": (rows("a,0,0.2", "a,0,0.2"), "psf.csv", "line 3: edge 0 of a has a row"),
    "no number": (rows("a,0,0.2", "a,1,wide"), "psf.csv", "mtf50 is 'wide'"),
    "NaN": (rows("a,0,nan"), "psf.csv", "empty cell"),
    "negative": (rows("a,0,-1"), "psf.csv", "from 0 to 10"),
    "lp/mm": (rows("a,0,55"), "psf.csv", "from 0 to 10"),
    "column": (rows("a,0,1,2", head="chart,edge,mtf50,mtf10"), "psf.csv", "column 'mtf10'"),
    "no column": (rows("a,0", head="chart,edge"), "psf.csv", "header must name"),
    "head without an end": (text("psf.csv", "1," * 10_000), "psf.csv", "header must name"),
    "no text": (
        lambda program: (program / "psf.csv").write_bytes(b"chart,edge,mtf50\n\xff,0,0.2\n"),
        "psf.csv",
        "is not UTF-8 text",
    ),
    "cells": (rows("a,0,0.2,1"), "psf.csv", "line 2: 4 cells"),
    "control characters": (rows("\x1b[2J,0,1"), "psf.csv", r"'\\x1b[2J'"),
    "task of no pair": (
        lambda program: write_json(program, "alignment.json", {"p9": {"refused": True}}),
        "alignment.json",
        "no task 'p9'",
    ),
    "not finite": (
        text(
            "alignment.json",
            '{"p0": {"homography_to_reference": [[1, 0, NaN], [0, 1, 0], [0, 0, 1]]}}',
        ),
        "alignment.json",
        "p0.homography_to_reference.0.2",
    ),
    "two answers": (
        answer(homography_to_reference=SINGULAR, refused=True),
        "alignment.json",
        "give one of",
    ),
    "no answer": (answer(), "alignment.json", "give one of"),
    "points": (answer(reference_points=TOO_FEW), "alignment.json", "expected 9"),
    "task twice": (
        text("alignment.json", '{"p0": {"refused": true}, "p0": {"refused": true}}'),
        "alignment.json",
        "repeated",
    ),
    "no JSON": (text("detections.json", "{"), "detections.json", "not JSON"),
    "place": (
        lambda program: write_json(program, "detections.json", {"c0": [[1.0]]}),
        "detections.json",
        "c0.0",
    ),
    "about": (lambda program: write_json(program, "about.json", {}), "about.json", "name"),
    "control characters in a name": (
        lambda program: write_json(program, "about.json", {"name": "a\0b"}),
        "about.json",
        "name: holds letters",
    ),
    "shape": (picture("changes", "c0", np.zeros((COLS, ROWS))), "c0.tif", "(60, 40)"),
    "colour": (
        lambda program: tifffile.imwrite(
            program / "changes" / "c0.tif", np.zeros((ROWS, COLS, 3), np.uint8), photometric="rgb"
        ),
        "c0.tif",
        "(40, 60, 3)",
    ),
    "infinite": (picture("simulation", "s0", infinite()), "s0.tif", "write NaN"),
    "no task": (picture("simulation", "s9", np.zeros((ROWS, COLS))), "s9.tif", "no such"),
    "no TIFF": (
        lambda program: (program / "simulation" / "s0.tif").write_bytes(b"II*\0"),
        "s0.tif",
        "write a grey TIFF",
    ),
    "another file": (
        lambda program: (program / "changes" / "c0.png").write_bytes(b""),
        "c0.png",
        "TASK.tif",
    ),
    "complex numbers": (
        lambda program: tifffile.imwrite(
            program / "simulation" / "s0.tif", np.zeros((ROWS, COLS), np.complex64)
        ),
        "s0.tif",
        "complex64",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_an_answer_that_cannot_be_used_is_named(fault: str, tmp_path: Path) -> None:
    spoil, file, said = FAULTS[fault]
    data, program = everything(tmp_path)[0], tmp_path / "spoilt"
    (program / "simulation").mkdir(parents=True)
    (program / "changes").mkdir()
    spoil(program)
    with pytest.raises(ResultsFileError) as refused:
        standoff.score_benchmark(program, data)
    assert Path(str(refused.value.source)).name == file
    assert said in str(refused.value)
    assert str(refused.value).isprintable()


@pytest.mark.slow
def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    data, program = everything(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ResultsFileError, match=r"expected psf\.csv"):
        standoff.score_benchmark([program, tmp_path / "empty"], data)
    with pytest.raises(ResultsFileError, match="is not a folder"):
        standoff.score_benchmark(tmp_path / "nowhere", data)
    with pytest.raises(standoff.ArgumentError):
        standoff.score_benchmark([], data)
    with pytest.raises(ResultsFileError, match=r"give them different names in about\.json"):
        standoff.score_benchmark([program, program], data)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["truth/psf.json", "truth/changes.json", "simulation/tasks.json", "truth/simulation/s0.tif"],
)
def test_a_file_of_the_set_that_is_not_the_manifests_is_named(name: str, tmp_path: Path) -> None:
    data, program = everything(tmp_path)
    content = bytearray((data / name).read_bytes())
    content[-3] ^= 1
    (data / name).write_bytes(content)
    with pytest.raises(ResultsFileError, match=r"not the file that manifest\.json names"):
        standoff.score_benchmark(program, data)


def test_a_manifest_of_another_format_is_refused(tmp_path: Path) -> None:
    data, program = everything(tmp_path)
    text_ = (data / "manifest.json").read_text()
    (data / "manifest.json").write_text(text_.replace('"1.0"', '"2.0"', 1))
    with pytest.raises(ResultsFileError, match="version"):
        standoff.score_benchmark(program, data)


def test_a_singular_homography_is_named_and_counts_as_wrong(tmp_path: Path) -> None:
    data, program = everything(tmp_path)[0], tmp_path / "singular"
    write_json(program, "alignment.json", {"p1": {"homography_to_reference": SINGULAR}})
    found = standoff.score_benchmark(program, data)
    path = program / "alignment.json"
    assert found.notes == (f"{path}: the homography of p1 is singular: it counts as wrong",)
    wrong = found.score("singular", "alignment", "wrong")
    assert wrong is not None
    assert wrong.value == 100 / 8
