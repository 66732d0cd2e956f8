import atexit
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from standoff.compiled_cache import drop_stale_code, provide_folder
from tests.privileges import ordinary_user


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "compiled_practice"
    (folder / "__pycache__").mkdir(parents=True)
    for name in ("__init__.py", "one.py", "__pycache__/one.f-1.py311.nbi", "__pycache__/one.1.nbc"):
        (folder / name).touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    sys.modules.pop("compiled_practice", None)


def set_times(folder: Path, pattern: str, time_s: float) -> None:
    for path in folder.rglob(pattern):
        os.utime(path, (time_s, time_s))


def test_code_newer_than_every_source_stays(package: Path) -> None:
    set_times(package, "*.py", 1000.0)
    set_times(package, "*.nb*", 2000.0)
    assert drop_stale_code(("compiled_practice",)) == 0
    assert len(list(package.rglob("*.nb*"))) == 2


def test_a_change_to_any_source_of_the_package_drops_its_compiled_code(package: Path) -> None:
    set_times(package, "*.nb*", 2000.0)
    set_times(package, "*.py", 1000.0)
    os.utime(package / "one.py", (3000.0, 3000.0))
    assert drop_stale_code(("compiled_practice",)) == 2
    assert not list(package.rglob("*.nb*"))
    assert drop_stale_code(("compiled_practice",)) == 0


def test_a_package_that_is_not_there_is_no_error() -> None:
    assert drop_stale_code(("no_such_package_of_anyone",)) == 0


def test_code_is_kept_for_one_process_where_neither_package_nor_cache_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    kept: list[str] = []
    monkeypatch.setattr(atexit, "register", lambda _, folder, **__: kept.append(folder))
    (tmp_path / "package").mkdir()
    provide_folder(tmp_path / "package", Path("/proc/nobody's/cache"))
    provide_folder(Path("/proc/self"), tmp_path / "home" / ".cache")
    assert not kept
    with ordinary_user():
        provide_folder(Path("/proc/self"), Path("/root/.cache/numba"))
    assert os.environ.pop("NUMBA_CACHE_DIR") == kept[0]
    assert Path(kept[0]).is_dir()
    shutil.rmtree(kept[0])
