"""Legal names of files that are long, or of letters that no terminal and no page should show."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition.session import Session
from calibration.noise import map_paths
from tests.standoff.conftest import Command

NAME_BYTES = 255


def longest(ending: str) -> str:
    """A name that is as long as one can be."""
    return "n" * (NAME_BYTES - len(ending)) + ending


def test_results_of_the_longest_names_are_written(
    command: Command, edge_file: Path, image_file: Path, tmp_path: Path
) -> None:
    out, table = tmp_path / longest(".json"), tmp_path / longest(".csv")
    command.done("calibrate", edge_file, "--out", out, "--csv", table)
    far = tmp_path / longest(".tif")
    command.done("simulate", image_file, "--zoom", 2, "--model", "bicubic", "--out", far)
    assert tifffile.imread(far).shape == (30, 45)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {out.name, table.name, far.name, edge_file.name, image_file.name}


@pytest.mark.parametrize(
    ("format_", "ending"),
    [("ome-tiff", ".ome.tif"), ("ome-zarr", ".ome.zarr"), ("nexus", ".nxs")],
)
def test_a_session_is_exported_under_the_longest_name(
    command: Command, session_dir: Path, tmp_path: Path, format_: str, ending: str
) -> None:
    pytest.importorskip({"ome-zarr": "zarr", "nexus": "h5py"}.get(format_, "tifffile"))
    before = set(tmp_path.iterdir())
    out = tmp_path / longest(ending)
    for force in ((), ("--force",)):
        command.done("export", session_dir, "--format", format_, "--out", out, *force)
        assert set(tmp_path.iterdir()) - before == {out}


def test_a_name_that_is_too_long_for_what_is_written_beside_it_is_refused_before_the_work(
    command: Command, tmp_path: Path
) -> None:
    out = tmp_path / longest(".json")
    done = command("noise", "--session", tmp_path / "none", "--out", out)
    assert (done.status, done.err.count("\n")) == (1, 1)
    longest_map = map_paths(out)["dark"].name
    assert f"a name of {len(longest_map)} bytes is too long" in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [longest(".tif"), "two\nlines \x1b[31m.tif", "no-\udcff-utf.tif"])
def test_a_photograph_of_an_odd_name_is_imported_and_calibrated(
    command: Command, edge_file: Path, tmp_path: Path, name: str
) -> None:
    photograph = edge_file.rename(tmp_path / name)
    session, out = tmp_path / "session", tmp_path / "psf.json"
    words = ("import", photograph, "--kind", "edge", "--height-mm", 100, "--out", session)
    for _ in range(2):  # the second time it is there already
        done = command.done(*words)
        assert done.err.replace("\n", "").isprintable()
    (capture,) = Session(session).captures
    assert capture.record.target.isprintable()
    assert len(capture.record.target) <= 200
    for files in ((photograph,), ("--session", session)):
        report = tmp_path / "report.html"
        done = command.done("calibrate", *files, "--out", out, "--report", report, "--force")
        assert all(line.isprintable() for line in (done.out + done.err).splitlines())
        assert json.loads(out.read_text("utf-8"))["sigma_x_px"] > 0


def test_two_photographs_of_one_long_beginning_are_two_targets(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    paths = [tmp_path / f"{'n' * 240}{number}.tif" for number in (1, 2)]
    for path in paths:
        os.link(edge_file, path)
    session = tmp_path / "session"
    words = ("import", *paths, "--kind", "edge", "--height-mm", 100, "--out", session)
    command.done(*words)
    assert len({one.record.target for one in Session(session).captures}) == 2


def test_training_pairs_of_a_photograph_of_the_longest_name_are_written(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    photograph = tmp_path / longest(".tif")
    levels = np.random.default_rng(6).integers(0, 4000, (96, 96)).astype(np.uint16)
    tifffile.imwrite(photograph, levels)
    out = tmp_path / "out"
    words = ("sr-pairs", photograph, "--psf", psf_file, "--zoom", 2, "--crop", 32, "--out", out)
    command.done(*words)
    assert list(out.glob("*/high/nnn*.png"))


def test_a_document_that_names_files_needs_a_name_in_utf_8(
    command: Command, tmp_path: Path
) -> None:
    done = command("noise", "--session", tmp_path, "--out", tmp_path / "no-\udcff-utf.json")
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "its name is not UTF-8; choose another" in done.err


def test_a_folder_that_was_removed_is_told_as_that(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    err = command.refused(1, "doctor")
    assert err == (
        "standoff: the folder in which the command runs has been removed; change to another\n"
    )
