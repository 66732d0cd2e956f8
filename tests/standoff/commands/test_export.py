import sys
from pathlib import Path
from typing import Any

import pytest
import tifffile

from acquisition.choices import ExportFormat
from tests.acquisition.session_export.sessions import exported_session
from tests.standoff.conftest import Command

ENDINGS: dict[ExportFormat, str] = {"ome-zarr": ".zarr", "nexus": ".nxs"}


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
    out = tmp_path / f"out.{format_}{ENDINGS[format_]}"
    err = command.refused(1, "export", tmp_path / "session", "--format", format_, "--out", out)
    assert "standoff[export]" in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_the_command_says_what_it_did(command: Command, session_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ome.tif"
    assert command.document("export", session_dir, "--format", "ome-tiff", "--out", out) == {
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
    command.done(*words)
    (out / "mark").write_text("of before")
    assert command(*words).status == 1
    assert (out / "mark").exists()
    command.done(*words, "--force")
    assert not (out / "mark").exists()
