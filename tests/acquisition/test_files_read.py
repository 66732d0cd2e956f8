"""Files that are read: regular ones, and those of a network drive."""

import errno
import os
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from acquisition.bench import load_bench
from acquisition.errors import BenchConfigError, SessionError
from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.remote_files import (
    is_url,
    remote_files_in,
    remote_status,
    url_of,
    write_remote,
)
from acquisition.session._reader import Session
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


@pytest.fixture
def folder() -> Iterator[Path]:
    """An empty folder in this process's memory."""
    system = fsspec.filesystem("memory")
    system.makedirs("/lab")
    yield Path("memory://lab")
    system.rm("/lab", recursive=True)


@pytest.mark.parametrize(
    "url", ["s3://bucket/a/b.png", "gs://bucket/c.tif", "memory://x", "https://127.0.0.1:80/d.jpg"]
)
def test_a_path_stands_for_a_url_and_is_shown_as_one(url: str) -> None:
    assert is_url(Path(url))
    assert url_of(Path(url)) == on_one_line(Path(url)) == url


@pytest.mark.parametrize("local", ["a.png", "/data/a.png", "C:/a.png", "a:b", "x/s3:/y", "./s3:/z"])
def test_other_paths_are_local(local: str) -> None:
    assert not is_url(Path("/") / local if local.startswith(".") else Path(local))


def test_what_is_written_is_there_with_its_size_and_listed(folder: Path) -> None:
    write_remote(folder / "a.bin", b"12345")
    write_remote(folder / "deeper" / "b.bin", b"1")
    status = remote_status(folder / "a.bin")
    assert (status.size_bytes, status.is_folder) == (5, False)
    assert remote_status(folder).is_folder
    assert list(remote_files_in(folder)) == [folder / "a.bin"]
    assert read_regular_file(folder / "a.bin") == b"12345"
    write_remote(folder / "a.bin", b"54321")
    assert remote_status(folder / "a.bin").version != status.version


def test_a_file_that_is_too_large_or_missing_is_an_error_of_the_system(folder: Path) -> None:
    write_remote(folder / "a.bin", b"12345")
    with pytest.raises(OSError) as large:
        read_regular_file(folder / "a.bin", 4)
    assert large.value.errno == errno.EFBIG
    with pytest.raises(FileNotFoundError) as missing:
        read_regular_file(folder / "b.bin")
    assert missing.value.filename == "memory://lab/b.bin"


def test_an_unknown_kind_of_url_and_one_that_is_not_installed_are_a_line_with_the_remedy() -> None:
    with pytest.raises(OSError) as unknown:
        remote_status(Path("what://bucket/a.png"))
    assert unknown.value.strerror is not None
    assert unknown.value.strerror.startswith("unknown kind of URL, what://")
    for protocol, package in (("s3", "s3fs"), ("gs", "gcsfs")):
        pytest.importorskip("fsspec")
        if __import__("importlib.util").util.find_spec(package) is None:
            with pytest.raises(OSError) as missing:
                remote_status(Path(f"{protocol}://bucket/a.png"))
            assert missing.value.strerror == (
                f"{protocol}:// is not installed: pip install 'standoff[{protocol}]'"
            )
