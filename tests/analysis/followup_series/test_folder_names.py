from pathlib import Path

import pytest

from analysis.followup_series import FolderNames
from analysis.sweep import Manifest


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


@pytest.mark.parametrize("stem", ["two\nlines", "\x1b[31mred", "no-\udcff-utf", "n" * 251])
def test_a_folder_has_letters_that_can_be_printed_and_a_name_that_is_not_too_long(
    tmp_path: Path, stem: str
) -> None:
    other = f"/q/{stem}.tif" if len(stem) > 200 else f"/q/{stem}2.tif"
    found = names(tmp_path, f"/p/{stem}.tif", other)
    assert len(set(found)) == 2
    for name in found:
        assert name.isprintable()
        assert len(name.encode()) <= 255


def test_a_long_stem_that_one_photograph_has_stays_as_it_is(tmp_path: Path) -> None:
    assert names(tmp_path, f"/p/{'n' * 251}.tif") == ["n" * 251]
