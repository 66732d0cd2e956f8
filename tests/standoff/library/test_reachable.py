"""What the system refuses of a path is told with what is in the way."""

import errno
import os
from collections.abc import Iterator
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import pytest

from acquisition.files import (
    refusal_text,
    require_folder,
    require_place,
    require_reachable,
    require_writable,
)
from standoff.errors import ApplicationError
from standoff.library import list_sessions, psf_history
from tests.privileges import NOBODY, ordinary_user


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, of an ordinary user; in it ``shut``, ``sealed`` and ``open``."""
    made = Path(mkdtemp())
    for name, mode in (("open", 0o755), ("sealed", 0o555), ("shut", 0o000), (".", 0o755)):
        (made / name).mkdir(exist_ok=True)
        if os.geteuid() == 0:
            os.chown(made / name, NOBODY, NOBODY)
        (made / name).chmod(mode)
    monkeypatch.chdir(made)
    yield made
    for name in ("sealed", "shut"):
        (made / name).chmod(0o755)
    rmtree(made)


def refusal(path: str) -> str:
    with pytest.raises(ApplicationError) as refused:
        require_place(Path(path))
    return str(refused.value)


def test_a_name_that_is_too_long_is_told_with_its_bytes(folder: Path) -> None:
    assert "a name of 256 bytes is too long" in refusal("é" * 128)
    assert "a name of 300 bytes is too long" in refusal(f"open/{'n' * 300}/x")
    assert "the path is too long" in refusal("open/" * 900 + "x")
    assert len(refusal("n" * 4000)) < 400
    require_place(Path("é" * 127))


def test_what_is_in_the_way_is_named(folder: Path) -> None:
    (folder / "file").touch()
    (folder / "loop").symlink_to("loop")
    assert refusal("open/../file/x") == (
        "cannot use open/../file/x: open/../file is not a folder; name another place"
    )
    assert "its symbolic links form a loop" in refusal("loop/x")
    with ordinary_user():
        assert "you may not enter the folder shut" in refusal("shut/a/b")
        assert "you may not write in the folder sealed" in refusal("sealed/a/b")
        require_reachable(Path("sealed/a/b"))


def test_a_place_that_is_free_is_none_to_complain_about(folder: Path) -> None:
    with ordinary_user():
        for path in ("x", "open/x", "open/yet/to/be/made", "s3://bucket/" + "n" * 300):
            require_place(Path(path))
        require_folder(Path("sealed"))
        require_folder(Path("open"), is_written=True)
        require_folder(Path("new"), is_written=True)


def test_a_folder_that_may_not_be_read_or_written_is_named(folder: Path) -> None:
    with ordinary_user():
        with pytest.raises(ApplicationError, match="may not look into the folder shut"):
            require_folder(Path("shut"))
        with pytest.raises(ApplicationError, match="may not write in the folder sealed"):
            require_folder(Path("sealed"), is_written=True)
        with pytest.raises(ApplicationError, match="may not write in the folder sealed"):
            require_writable([Path("open/x"), Path("sealed/x.json")])


def test_folders_of_sessions_and_calibrations_that_may_not_be_read_are_no_empty_ones(
    folder: Path,
) -> None:
    with ordinary_user():
        with pytest.raises(ApplicationError, match="cannot read the folder shut"):
            list_sessions("shut")
        with pytest.raises(ApplicationError, match="may not look into the folder shut"):
            psf_history(["shut"])
        (listed,) = list_sessions(".")
    assert listed["session"] == "shut"
    assert "you may not enter the folder shut" in listed["error"]


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.EROFS])
def test_what_else_the_system_says_is_repeated(number: int) -> None:
    said = refusal_text(Path("x"), OSError(number, os.strerror(number)))
    assert said == f"cannot use x: {os.strerror(number)}"
