import errno
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.remote_files import (
    is_url,
    remote_files_in,
    remote_status,
    url_of,
    write_remote,
)


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
