from pathlib import Path

import pytest

from analysis.followup_series.folder_names import FolderNames
from analysis.sweep.manifest import Manifest


def names(tmp_path: Path, *paths: str, reserved: tuple[str, ...] = ()) -> list[str]:
    with Manifest(map(Path, paths), tmp_path) as manifest:
        found = FolderNames.of(manifest, reserved)
    return [found.name_of(Path(path)) for path in paths]


def test_a_folder_is_named_by_its_stem(tmp_path: Path) -> None:
    assert names(tmp_path, "/p/one.tif", "/q/two.one.tif") == ["one", "two.one"]


@pytest.mark.parametrize("other", ["/p/one.png", "/q/one.tif", "/p/ONE.tif"])
def test_photographs_of_one_stem_are_told_apart_the_same_in_any_order(
    tmp_path: Path, other: str
) -> None:
    forth = names(tmp_path, "/p/one.tif", other, "/p/two.tif")
    assert names(tmp_path, "/p/two.tif", other, "/p/one.tif") == forth[::-1]
    # Also where a file system takes capitals for small letters.
    assert len({name.casefold() for name in forth}) == 3
    assert forth[0].startswith("one-")
    assert forth[2] == "two"


@pytest.mark.parametrize("path", ["/p/..tif", "/p/...tif", "/p/summary.json.tif"])
def test_no_folder_takes_the_place_of_another_file(tmp_path: Path, path: str) -> None:
    (name,) = names(tmp_path, path, reserved=("summary.json",))
    assert name not in {".", "..", "summary.json"}
    assert Path(name).name == name
