"""H.json: written and read by one class."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.errors import HomographyFileError
from calibration.files import read_homography, write_homography
from calibration.registration import Homography

MATRIX = np.array([[1.5, 0.1, -20.0], [-0.1, 1.5, 5.0], [1e-5, 0.0, 1.0]])


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "H.json"
    written = Homography(matrix=MATRIX, size=(640, 480), distortion_k1=-0.01)
    write_homography(path, written)
    found = read_homography(path)
    np.testing.assert_array_equal(found.matrix, MATRIX)
    assert (found.size, found.distortion_k1) == ((640, 480), -0.01)
    assert json.loads(path.read_text("utf-8")) == {
        "schema": "standoff.homography/1",
        "matrix": MATRIX.tolist(),
        "size": [640, 480],
        "distortion_k1": -0.01,
        "provenance": None,
    }


def test_the_distortion_may_be_left_out(tmp_path: Path) -> None:
    path = stored(tmp_path, {})
    assert read_homography(path).distortion_k1 == 0.0


def stored(folder: Path, change: dict[str, Any]) -> Path:
    path = folder / "H.json"
    content = {"schema": "standoff.homography/1", "matrix": MATRIX.tolist(), "size": [30, 20]}
    path.write_text(json.dumps(content | change), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("schema", "standoff.psf/1"),
        ("matrix", [[1, 0], [0, 1]]),
        ("matrix", "unit"),
        ("matrix", [[1, 0, 0], [0, 1, 0], [0, 0, 10**400]]),
        ("matrix", [[1, 0, 0], [0, 0, 5], [0, 0, 1]]),
        ("size", 30),
        ("size.1", [30]),
        ("size.0", [0, 20]),
        ("size.1", [30, 2.5]),
        ("distortion_k1", 1),
        ("distortion_k1", None),
        ("distortion_k1", True),
        ("distortion_k1", "-0.1"),
        ("distortion_k1", 10**400),
    ],
)
def test_the_value_at_fault_is_named(tmp_path: Path, key: str, value: object) -> None:
    path = stored(tmp_path, {key.partition(".")[0]: value})
    with pytest.raises(HomographyFileError) as refused:
        read_homography(path)
    assert (refused.value.source, refused.value.key) == (str(path), key)


def test_a_matrix_cannot_be_changed_afterwards() -> None:
    homography = Homography(matrix=MATRIX, size=(640, 480))
    with pytest.raises(ValueError):
        homography.matrix[0, 0] = 2.0
    assert MATRIX.flags.writeable
