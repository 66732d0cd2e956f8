"""An export is whole or not there, and holds one capture at a time."""

import json
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from acquisition.errors import SessionError
from acquisition.session import Photograph, Session
from standoff.errors import ApplicationError
from standoff.workflows import export_session
from standoff.workflows.session_export.choices import ExportFormat
from tests.acquisition.session_fixtures import plan_of, writer
from tests.standoff.conftest import Command
from tests.standoff.workflows.session_export.sessions import exported_session, request_of

NAMES: dict[ExportFormat, tuple[str, str | None]] = {
    "ome-tiff": ("out.ome.tif", None),
    "ome-zarr": ("out.ome.zarr", "zarr"),
    "nexus": ("out.nxs", "h5py"),
}
FORMATS = pytest.mark.parametrize("format_", NAMES)


def out_of(format_: ExportFormat, folder: Path) -> Path:
    name, library = NAMES[format_]
    if library is not None:
        pytest.importorskip(library, reason="needs standoff[export]")
    return folder / name


@FORMATS
def test_what_is_interrupted_leaves_what_was_there(format_: ExportFormat, tmp_path: Path) -> None:
    session = exported_session(tmp_path / "session")
    out = out_of(format_, tmp_path)
    export_session(session, request_of(format_, out))

    def content() -> dict[str, bytes]:
        files = [out] if out.is_file() else sorted(out.rglob("*"))
        return {str(file): file.read_bytes() for file in files if file.is_file()}

    before = content()

    def interrupt(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_session(session, request_of(format_, out), interrupt)
    assert content() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([out.name, "session"])
    export_session(session, request_of(format_, out))  # and is replaced by a whole one
    assert len(content()) == len(before)


@FORMATS
def test_a_damaged_capture_is_an_error_and_no_export(format_: ExportFormat, tmp_path: Path) -> None:
    session = exported_session(tmp_path / "session")
    out = out_of(format_, tmp_path)
    capture = session.path / session.records[2].file
    capture.write_bytes(capture.read_bytes()[:-1] + b"x")
    with pytest.raises(SessionError):
        export_session(session, request_of(format_, out))
    assert [path.name for path in tmp_path.iterdir()] == ["session"]


FLAT = np.full((256, 256), 100.0, np.float32)


def session_of(captures: int, path: Path) -> Session:
    plan = plan_of(
        heights_mm=[float(height) for height in range(captures)],
        targets=[{"kind": "flat", "target": "paper"}],
    )
    photograph = Photograph(
        image_dn=FLAT, variance_dn2=FLAT, frames=3, pixel_format="float", max_level_dn=255.0
    )
    with writer(path, plan=plan) as session:
        for entry in session.entries:
            session.add_photograph(entry, photograph)
    return Session(path)


@FORMATS
def test_captures_are_held_one_at_a_time(format_: ExportFormat, tmp_path: Path) -> None:
    out = out_of(format_, tmp_path)
    request = request_of(format_, out, with_scale=False)
    sessions = [session_of(captures, tmp_path / str(captures)) for captures in (4, 20)]
    export_session(sessions[0], request)  # imports the library
    peaks = []
    for session in sessions:
        tracemalloc.start()
        export_session(session, request)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Sixteen captures more, of a mean and a variance each: less than two of them in memory.
    assert peaks[1] - peaks[0] < 2 * 2 * FLAT.nbytes


@pytest.mark.parametrize(("format_", "library"), [("ome-zarr", "zarr"), ("nexus", "h5py")])
def test_a_library_that_is_missing_is_named_with_its_extra(
    format_: ExportFormat,
    library: str,
    command: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    exported_session(tmp_path / "session")
    monkeypatch.setitem(sys.modules, library, None)
    out = tmp_path / NAMES[format_][0]
    done = command("export", tmp_path / "session", "--format", format_, "--out", out)
    assert done.status == 1
    assert "standoff[export]" in done.err
    assert done.err.count("\n") == 1
    assert not out.exists()


def test_the_command_says_what_it_did(command: Command, session_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ome.tif"
    done = command("export", session_dir, "--format", "ome-tiff", "--out", out, "--json")
    assert done.status == 0
    assert json.loads(done.out) == {
        "out": str(out),
        "format": "ome-tiff",
        "captures": 6,
        "with_scale": 0,
        "left_out": 0,
    }
    with tifffile.TiffFile(out) as file:
        assert len(file.series) == 6
        assert "journal.jsonl" in (file.ome_metadata or "")


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (("--format", "ome-tiff", "--out", "x.tif"), 2),  # Bio-Formats would read it as plain TIFF
        (("--format", "nexus", "--out", "session/journal.nxs"), 2),
        (("--format", "ome-zarr", "--out", "session/captures/x.zarr"), 2),
        (("--format", "ome-tiff", "--out", "nowhere/x.ome.tif"), 1),
        (("--format", "png", "--out", "x.png"), 2),
        (("--format", "ome-zarr", "--out", "folder.zarr", "--force"), 1),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    command: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    status: int,
) -> None:
    exported_session(tmp_path / "session")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.zarr").mkdir()
    (tmp_path / "folder.zarr" / "thesis.txt").write_text("not to be replaced")
    before = sorted(tmp_path.rglob("*"))
    done = command("export", "session", *words)
    assert done.status == status
    assert done.err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_a_zarr_that_is_there_is_replaced_only_when_told(command: Command, tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="needs standoff[export]")
    exported_session(tmp_path / "session")
    out = tmp_path / "out.zarr"
    words: tuple[Any, ...] = ("export", tmp_path / "session", "--format", "ome-zarr", "--out", out)
    assert command(*words).status == 0
    (out / "mark").write_text("of before")
    assert command(*words).status == 1
    assert (out / "mark").exists()
    assert command(*words, "--force").status == 0
    assert not (out / "mark").exists()


def test_a_session_without_captures_is_refused(tmp_path: Path) -> None:
    with writer(tmp_path / "session"):
        pass
    with pytest.raises(ApplicationError):
        export_session(
            Session(tmp_path / "session"), request_of("ome-tiff", tmp_path / "x.ome.tif")
        )


@pytest.mark.parametrize(
    "changes",
    [
        {"heights_mm": (), "scale_px_per_mm": ()},
        {"scale_px_per_mm": None},
        {"scale_px_per_mm": (0.0, -1.0)},
        {"pupil_offset_mm": -500.0},  # the camera would be inside the target
        {"heights_mm": (300.0, 310.0)},
    ],
)
def test_a_geometry_that_does_not_tell_the_scale_gives_none(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    session = exported_session(tmp_path / "session")
    request = request_of("ome-tiff", tmp_path / "x.ome.tif")
    assert request.geometry is not None
    other = replace(request, geometry=request.geometry.model_copy(update=changes))
    assert export_session(session, other).with_scale == 0
    assert export_session(session, request).with_scale == 5
