"""The one way a model is written to a JSON file and read from it."""

import json
import os
import stat
from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, model_validator

from calibration.documents import json_object, read_document, write_document
from calibration.errors import DocumentError, HomographyFileError
from calibration.files import read_homography


class LensFileError(DocumentError):
    pass


class Lens(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")

    schema_name: Literal["standoff.lens/1"] = Field(default="standoff.lens/1", alias="schema")
    focal_length_mm: float
    stops: tuple[float, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> "Lens":
        if self.focal_length_mm == 0:
            raise ValueError("no lens")
        return self


class Mount(BaseModel):
    back_focus_mm: float
    is_locked: bool | None = None


class Rig(Lens):
    mount: Mount | None = None
    shifts_px: dict[str, tuple[tuple[float, ...], ...]] = {}
    matrix: list[list[float]] | None = None
    is_new: bool = True
    facts: dict[str, bool | float] = {}


RIG = {
    "schema": "standoff.lens/1",
    "focal_length_mm": 16,
    "facts": {"stabilised": True, "zoom": 2},
}
LENS = Lens(focal_length_mm=16.0, stops=(2.8, 4.0))


def read(path: Path) -> Lens:
    return read_document(path, Lens, LensFileError, "make one")


def refusal(path: Path) -> LensFileError:
    with pytest.raises(LensFileError) as refused:
        read(path)
    assert refused.value.source == str(path)
    assert path.name in str(refused.value)
    return refused.value


def test_a_document_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    write_document(path, LENS, LensFileError)
    assert read(path) == LENS
    assert json.loads(path.read_text(encoding="utf-8")) == json_object(LENS)


def test_the_schema_stands_first_in_the_file() -> None:
    expected = {"schema": "standoff.lens/1", "focal_length_mm": 16.0, "stops": [2.8, 4.0]}
    assert list(json_object(LENS).items()) == list(expected.items())


def test_keys_that_the_model_does_not_know_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    path.write_text(json.dumps(json_object(LENS) | {"maker": "x"}), encoding="utf-8")
    assert read(path) == LENS


@pytest.mark.parametrize("content", [b"{", b"\xef\xbb\xbf{}", b"II*\x00\xff\xfe\x80"])
def test_what_is_no_json_is_refused_as_a_whole(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "lens.json"
    path.write_bytes(content)
    assert refusal(path).key is None


@pytest.mark.parametrize(
    "number", ["Infinity", "-Infinity", "NaN", "1e999", "1" + 400 * "0" + ".0"]
)
@pytest.mark.parametrize(
    ("key", "content"),
    [
        ("focal_length_mm", '{"schema": "standoff.lens/1", "focal_length_mm": %s}'),
        ("stops.1", '{"schema": "standoff.lens/1", "focal_length_mm": 8, "stops": [2, %s]}'),
    ],
)
def test_a_number_without_bounds_is_refused_by_its_place(
    tmp_path: Path, number: str, key: str, content: str
) -> None:
    # A psf.json with a width of Infinity ended `compare` in a search for a root.
    path = tmp_path / "lens.json"
    path.write_text(content % number, encoding="utf-8")
    assert refusal(path).key == key
    assert "finite number" in str(refusal(path))


@pytest.mark.parametrize("content", ["[1]", "{}", '{"schema": 7}', '{"schema": "standoff.psf/1"}'])
def test_another_schema_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "lens.json"
    path.write_text(content, encoding="utf-8")
    assert refusal(path).key == "schema"


@pytest.mark.parametrize(
    ("content", "key"),
    [
        ({}, "focal_length_mm"),
        ({"focal_length_mm": "wide"}, "focal_length_mm"),
        ({"focal_length_mm": 16, "stops": [1, "x"]}, "stops.1"),
        ({"focal_length_mm": 0}, None),
    ],
)
def test_the_value_at_fault_is_named(
    tmp_path: Path, content: dict[str, object], key: str | None
) -> None:
    path = tmp_path / "lens.json"
    path.write_text(json.dumps({"schema": "standoff.lens/1"} | content), encoding="utf-8")
    assert refusal(path).key == key


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.json").key is None


@pytest.mark.parametrize("name", ["nowhere/lens.json", "folder"])
def test_a_path_that_cannot_be_written_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(LensFileError) as refused:
        write_document(tmp_path / name, LENS, LensFileError)
    assert refused.value.source == str(tmp_path / name)


def test_a_number_that_is_none_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError):
        write_document(tmp_path / "lens.json", Lens(focal_length_mm=float("inf")), LensFileError)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_the_old_file_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lens.json"
    write_document(path, LENS, LensFileError)
    before = path.read_bytes()

    def no_space(descriptor: int) -> None:
        # fsync of the new file fails as on a full disk; that of a directory is not reached.
        assert stat.S_ISREG(os.fstat(descriptor).st_mode)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(LensFileError) as refused:
        write_document(path, Lens(focal_length_mm=25.0), LensFileError)
    assert isinstance(refused.value.__cause__, OSError)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["lens.json"]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"focal_length_mm": True}, "focal_length_mm"),
        ({"stops": [2, False]}, "stops.1"),
        ({"mount": {"back_focus_mm": True}}, "mount.back_focus_mm"),
        ({"shifts_px": {"left": [[0.5], [True]]}}, "shifts_px.left.1.0"),
        ({"matrix": [[1.0, True]]}, "matrix.0.1"),
    ],
)
def test_a_boolean_is_no_number(tmp_path: Path, change: dict[str, object], key: str) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(RIG | change), encoding="utf-8")
    with pytest.raises(LensFileError) as refused:
        read_document(path, Rig, LensFileError, "write it anew")
    assert refused.value.key == key
    assert "expected a number" in str(refused.value)


def test_a_boolean_is_taken_where_one_may_stand_and_where_nobody_looks(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    more = {"is_new": False, "mount": {"back_focus_mm": 46.5, "is_locked": True}}
    path.write_text(json.dumps(RIG | more | {"of a later version": [True]}), encoding="utf-8")
    found = read_document(path, Rig, LensFileError, "write it anew")
    assert found.mount == Mount(back_focus_mm=46.5, is_locked=True)
    assert found.is_new is False
    assert found.facts == {"stabilised": True, "zoom": 2.0}


def test_a_boolean_in_the_pose_of_a_camera_is_no_number(tmp_path: Path) -> None:
    # Its matrix is an array, which takes true for 1.
    path = tmp_path / "H.json"
    matrix: list[list[object]] = [[True, 0, 0], [0, 1, 0], [0, 0, 1]]
    document = {"schema": "standoff.homography/1", "matrix": matrix, "size": [8, 6]}
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(HomographyFileError) as refused:
        read_homography(path)
    assert refused.value.key == "matrix.0.0"


def test_a_name_that_is_no_utf_8_is_not_half_written(tmp_path: Path) -> None:
    class Named(Lens):
        file: str = "no-\udcff-utf.tif"

    with pytest.raises(LensFileError):
        write_document(tmp_path / "lens.json", Named(focal_length_mm=8.0), LensFileError)
    assert list(tmp_path.iterdir()) == []
