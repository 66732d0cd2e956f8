"""No code path writes over a capture: every writer refuses, and there are no others."""

import ast
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import ExportError, SessionError
from acquisition.files import make_folder, write_file, written_together
from acquisition.photographs import write_float_tiff
from acquisition.session import (
    commit_file,
    refuse_capture,
    whole_file,
    write_shared,
)
from acquisition.session._files import atomic_write, move_new, write_new_hashed
from acquisition.session_export._export import _put_in_place
from standoff.errors import ApplicationError
from tests.acquisition.session_fixtures import whole_session
from tests.standoff.conftest import Command

ROOT = Path(__file__).parents[2]
PACKAGES = ("acquisition", "analysis", "calibration", "hil_mocks", "simulation", "standoff")

WRITERS = {
    "acquisition/session/_capture_files.py": "moves to free names only",
    "acquisition/session/_journal.py": "the head of the journal",
    "acquisition/session/_files.py": "tried below",
    "acquisition/session_export/_export.py": "tried below",
    "acquisition/session_export/_ome.py": "in the folder that export.py puts in place",
    "acquisition/stages/_serial_link.py": "appends to a log",
    "analysis/detectability/_sweep.py": "in the working folder of a sweep",
    "analysis/detectors/_hosts.py": "in a temporary folder",
    "analysis/sr_dataset/_dataset.py": "in a data set, begun with a whole_file",
    "analysis/sr_dataset/_pairs.py": "in a data set, begun with a whole_file",
    "analysis/sweep/cluster.py": "in the working folder of a sweep",
    "analysis/sweep/_engine.py": "in the working folder of a sweep",
    "analysis/sweep/_work.py": "in the working folder of a sweep",
    "standoff/console/guide/_certificate.py": "in a temporary folder",
    "standoff/console/guide/_stills.py": "beside the parts of photographs that arrive",
    "standoff/console/photographs/_inbox.py": "photographs that have arrived, under their hashes",
    "standoff/console/photographs/_uploads.py": "parts of what arrives, under their hashes",
    "standoff/console/pose_curves.py": "in a temporary folder",
    "acquisition/files/_writing.py": "tried below",
    "standoff/console/web/_zip_stream.py": "into an archive that is sent, not kept",
    "standoff/library/swept_photographs.py": "in a temporary folder",
    "standoff/streams.py": "standard output",
    "standoff/warm_up.py": "in a temporary folder",
}
"""Every module that opens a file for writing or renames one, and why no capture is in its way."""

NAMES = {"write_bytes", "write_text", "touch", "rename", "copyfile", "copy2", "copytree", "mkstemp"}
NAMES |= {"symlink_to", "hardlink_to", "truncate", "NamedTemporaryFile", "tofile", "to_csv"}


def writes(call: ast.Call) -> bool:
    """Whether a call may create or replace a file, by its looks."""
    function = call.func
    if not isinstance(function, ast.Attribute | ast.Name):
        return False
    name = function.attr if isinstance(function, ast.Attribute) else function.id
    texts = [one.value for one in call.args if isinstance(one, ast.Constant)]
    if name in ("open", "fdopen"):
        modes = [one for one in texts if isinstance(one, str) and set(one) <= set("wxabt+r")]
        flags = ast.unparse(call)
        return any(set(mode) & set("wxa+") for mode in modes) or "O_CREAT" in flags
    if name == "replace":  # of a path; text has two arguments
        return len(call.args) == 1 and not call.keywords
    return name in NAMES


def test_every_module_that_writes_files_is_known() -> None:
    found = {
        file.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for file in (ROOT / package).rglob("*.py")
        if any(
            isinstance(node, ast.Call) and writes(node)
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        )
    }
    assert found == WRITERS.keys()


def by_block(manager: Callable[[Path], object]) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with manager(path) as given:  # type: ignore[attr-defined]
            if isinstance(given, Path):
                (given / path.name if given.is_dir() else given).write_bytes(b"other")
            else:
                given.write(b"other")

    return write


def moved(path: Path) -> None:
    other = path.parent.parent / "other.tif"
    other.write_bytes(b"other")
    move_new(other, path)


TRIED: dict[str, Callable[[Path], object]] = {
    "atomic_write": lambda path: atomic_write(path, b"other"),
    "write_new_hashed": lambda path: write_new_hashed(path, (b"other",)),
    "commit_file": lambda path: commit_file(path, b"other"),
    "write_shared": lambda path: write_shared(path, b"other"),
    "write_file": lambda path: write_file(path, b"other"),
    "write_float_tiff": lambda path: write_float_tiff(path, np.ones((2, 2), np.float32), ""),
    "whole_file": by_block(whole_file),
    "written_together": by_block(written_together),
    "export": by_block(_put_in_place),
    "move_new": moved,
    "make_folder": lambda path: make_folder(path.parent),
}


@pytest.mark.parametrize("name", TRIED)
def test_a_writer_refuses_the_name_of_a_capture(tmp_path: Path, name: str) -> None:
    (record, *_) = whole_session(tmp_path)
    capture = tmp_path / record.file
    before = capture.read_bytes()
    with pytest.raises((OSError, ApplicationError, ExportError, SessionError)):
        TRIED[name](capture)
    assert capture.read_bytes() == before
    assert sorted(file.name for file in capture.parent.iterdir()) == sorted(
        Path(one.file).name for one in (record, *_)
    )


@pytest.mark.parametrize("lost", ["journal.jsonl", "session.json"])
def test_a_folder_of_captures_is_known_without_journal_or_manifest(
    tmp_path: Path, lost: str
) -> None:
    (record, *_) = whole_session(tmp_path)
    (tmp_path / lost).unlink()
    link = tmp_path / "link"
    link.symlink_to(tmp_path)
    with pytest.raises(OSError, match="never overwritten"):
        refuse_capture(link / record.file)
    refuse_capture(tmp_path / "results" / "psf.json")


def test_force_does_not_replace_a_capture(tmp_path: Path, command: Command) -> None:
    (record, *_) = whole_session(tmp_path / "s")
    capture = tmp_path / "s" / record.file
    before = capture.read_bytes()
    other = next((tmp_path / "s" / "captures").glob("0001*"))
    words = ("--zoom", 1.5, "--model", "bicubic", "--out", other, "--force")
    done = command("simulate", capture, *words)
    assert done.status == 1
    assert "never overwritten" in done.err
    assert capture.read_bytes() == before
