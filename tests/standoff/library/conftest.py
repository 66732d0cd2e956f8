"""The one folder in which every result of a process is made."""

import shutil
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def folder_of_results(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The examples' files, once a process: results are cached and name files by where they were."""
    return Path(shutil.copytree(example_files, tmp_path_factory.mktemp("results") / "files"))


@pytest.fixture
def there(folder_of_results: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a detector that a worker can import."""
    monkeypatch.chdir(folder_of_results)
    monkeypatch.syspath_prepend(str(folder_of_results))
    return folder_of_results
