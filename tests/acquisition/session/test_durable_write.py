import errno
import hashlib
import os
from pathlib import Path

import pytest

from acquisition.session.files import atomic_write, write_new_hashed


def test_a_file_is_written_whole_and_leaves_no_part(tmp_path: Path) -> None:
    atomic_write(tmp_path / "a.bin", b"new")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"a.bin": b"new"}


def test_the_part_of_a_killed_run_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "a.bin.part").write_bytes(b"half of something longer")
    atomic_write(tmp_path / "a.bin", b"new")
    assert [file.name for file in tmp_path.iterdir()] == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"new"


def test_a_full_disk_leaves_the_file_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError) as refused:
        atomic_write(path, b"new")
    assert refused.value.errno == errno.ENOSPC
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"a.bin": b"old"}


def test_data_are_durable_before_the_name_and_the_name_before_the_return(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def logged_fsync(descriptor: int) -> None:
        is_directory = Path(f"/proc/self/fd/{descriptor}").resolve() == tmp_path.resolve()
        steps.append("fsync directory" if is_directory else "fsync file")
        fsync(descriptor)

    def logged_replace(self: Path, target: Path) -> Path:
        steps.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", logged_fsync)
    monkeypatch.setattr(Path, "replace", logged_replace)
    atomic_write(tmp_path / "a.bin", b"new")
    assert steps == ["fsync file", "rename", "fsync directory"]


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    digest = write_new_hashed(tmp_path / "a.bin", (b"abc-", memoryview(b"def")))
    assert digest == hashlib.sha256((tmp_path / "a.bin").read_bytes()).hexdigest()


def test_a_write_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError) as refused:
        write_new_hashed(tmp_path / "a.bin", (b"half",))
    assert refused.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_does_not_fit_is_refused_with_the_systems_reason(tmp_path: Path) -> None:
    # A limit on the size of files is refused in the same place as a full disk.
    resource = pytest.importorskip("resource", reason="a limit of POSIX systems")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8000, limits[1]))
    try:
        with pytest.raises(OSError) as refused:
            write_new_hashed(tmp_path / "a", (bytes(80_000),))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert refused.value.errno == errno.EFBIG
    assert list(tmp_path.iterdir()) == []
