"""An export is whole or not there, and holds one capture at a time."""

import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.choices import ExportFormat
from acquisition.errors import ExportError, SessionError
from acquisition.session import Photograph, Session
from acquisition.session_export import write_export
from tests.acquisition.session_export.sessions import exported_session, geometry, request_of
from tests.acquisition.session_fixtures import plan_of, writer

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


@pytest.mark.slow
@FORMATS
def test_what_is_interrupted_leaves_what_was_there(format_: ExportFormat, tmp_path: Path) -> None:
    session = exported_session(tmp_path / "session")
    out = out_of(format_, tmp_path)
    write_export(session, request_of(format_, out))

    def content() -> dict[str, bytes]:
        files = [out] if out.is_file() else sorted(out.rglob("*"))
        return {str(file): file.read_bytes() for file in files if file.is_file()}

    before = content()

    def interrupt(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_export(session, request_of(format_, out), interrupt)
    assert content() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([out.name, "session"])
    write_export(session, request_of(format_, out))  # and is replaced by a whole one
    assert len(content()) == len(before)


@FORMATS
def test_a_damaged_capture_is_an_error_and_no_export(format_: ExportFormat, tmp_path: Path) -> None:
    session = exported_session(tmp_path / "session")
    out = out_of(format_, tmp_path)
    capture = session.path / session.records[2].file
    capture.write_bytes(capture.read_bytes()[:-1] + b"x")
    with pytest.raises(SessionError):
        write_export(session, request_of(format_, out))
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


@pytest.mark.slow
@FORMATS
def test_captures_are_held_one_at_a_time(format_: ExportFormat, tmp_path: Path) -> None:
    out = out_of(format_, tmp_path)
    request = request_of(format_, out, with_scale=False)
    sessions = [session_of(captures, tmp_path / str(captures)) for captures in (4, 20)]
    write_export(sessions[0], request)  # imports the library
    peaks = []
    for session in sessions:
        tracemalloc.start()
        write_export(session, request)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Sixteen captures more, of a mean and a variance each: less than two of them in memory.
    assert peaks[1] - peaks[0] < 2 * 2 * FLAT.nbytes


def test_a_session_without_captures_is_refused(tmp_path: Path) -> None:
    with writer(tmp_path / "session"):
        pass
    with pytest.raises(ExportError):
        write_export(Session(tmp_path / "session"), request_of("ome-tiff", tmp_path / "x.ome.tif"))


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
    other = replace(request, scale_at=geometry().model_copy(update=changes).scale_at)
    assert write_export(session, other).with_scale == 0
    assert write_export(session, request).with_scale == 5
