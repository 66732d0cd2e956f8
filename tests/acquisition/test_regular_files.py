"""What is no file is named as what it is, before it is opened."""

import os
from pathlib import Path

import pytest

from acquisition.bench import load_bench
from acquisition.errors import BenchConfigError, SessionError
from acquisition.regular_files import read_regular_file
from acquisition.session.reader import Session
from acquisition.untrusted import MOST_BRACKETS, parse_json
from analysis.errors import ResultsFileError
from calibration.errors import PsfFileError
from calibration.files import read_psf
from standoff.library.detectability import read_any_curves
from tests.acquisition.session_fixtures import writer


def test_a_file_of_the_size_allowed_is_read_and_one_byte_more_refused(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"abcd")
    assert read_regular_file(path, 4) == b"abcd"
    with pytest.raises(OSError, match="at most"):
        read_regular_file(path, 3)


def test_what_is_no_file_is_refused_by_its_kind(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path, kind in ((pipe, "a pipe"), (tmp_path, "a folder"), (Path("/dev/zero"), "a device")):
        with pytest.raises(OSError, match=kind):
            read_regular_file(path)


def test_documents_sessions_and_bench_files_never_wait_for_a_pipe_or_read_a_device(
    tmp_path: Path,
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        with pytest.raises(PsfFileError, match="not a file"):
            read_psf(path)
        with pytest.raises(BenchConfigError, match="not a file"):
            load_bench(path)
        with pytest.raises(ResultsFileError, match="not a file"):
            read_any_curves(path)
    writer(tmp_path / "session").close()
    journal = tmp_path / "session" / "journal.jsonl"
    journal.unlink()
    journal.symlink_to("/dev/zero")
    with pytest.raises(SessionError, match="a device, not a file"):
        Session(tmp_path / "session")


def test_json_that_would_fill_the_memory_with_empty_lists_is_refused() -> None:
    with pytest.raises(ValueError, match="lists and objects"):
        parse_json("[" + "[]," * MOST_BRACKETS + "[]]")
