"""`standoff pose` with what the operator knows, and for a follow-up from nearer."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import ArrayLike
from PIL import Image

from analysis.detectability._curves import DetectabilityCurves
from analysis.results_file import write_results
from simulation.arrays import FloatArray
from tests.analysis.detectability.test_curves import curve
from tests.standoff.changed_photographs import FAR, NEAR, ZOOM, changed_pair, write_levels
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

pytestmark = pytest.mark.slow

MATRIX = np.array(
    [
        [ZOOM, 0, (NEAR[1] - 1) / 2 - ZOOM * (FAR[1] - 1) / 2 - 2.3],
        [0, ZOOM, (NEAR[0] - 1) / 2 - ZOOM * (FAR[0] - 1) / 2],
        [0, 0, 1],
    ]
)


@pytest.fixture
def near(tmp_path: Path) -> Path:
    return write_levels(tmp_path / "near.tif", changed_pair(1, 0.0).reference)


@pytest.fixture
def far(tmp_path: Path) -> Path:
    return write_levels(tmp_path / "far.tif", changed_pair(1, 0.0).followup)


@pytest.fixture
def curves(tmp_path: Path) -> Path:
    path = tmp_path / "curves.json"
    write_results(path, DetectabilityCurves(curves=[curve()]))
    return path


def place(matrix: ArrayLike) -> FloatArray:
    """Where a pose takes the middle of the follow-up, and points beside it."""
    points = np.array([[104.5, 84.5, 1], [10, 10, 1], [190, 150, 1]]).T
    x, y, w = np.asarray(matrix, dtype=np.float64) @ points
    return np.array([x / w, y / w])


@pytest.mark.parametrize("hint", ["zoom", "homography", "points", "mask"])
def test_each_hint_leads_to_the_pose(
    command: Command, near: Path, far: Path, curves: Path, tmp_path: Path, hint: str
) -> None:
    rough = MATRIX * [[1.01, 1, 1], [1, 0.99, 1], [1, 1, 1]]
    document = {"schema": "standoff.homography/1", "matrix": rough.tolist(), "size": FAR[::-1]}
    (tmp_path / "homography").write_text(json.dumps(document))
    corners = np.array([[20.0, 20], [180, 25], [25, 150], [185, 140], [100, 80]])
    there = np.round(corners * ZOOM + MATRIX[:2, 2])
    header = "followup_x_px,followup_y_px,reference_x_px,reference_y_px"
    rows = [",".join(map(str, [*a, *b])) for a, b in zip(corners, there, strict=True)]
    (tmp_path / "points").write_text("\n".join([header, *rows]))
    mask = np.zeros(FAR, np.uint8)
    mask[:40, :50] = 255
    Image.fromarray(mask).save(tmp_path / "mask", format="png")
    value: object = 1.4 if hint == "zoom" else tmp_path / hint
    option = "--expect-zoom" if hint == "zoom" else f"--{hint}"
    words = ("pose", near, far, "--curves", curves, "--min-dprime", 1.0, option, value)
    found = command.document(*words)
    # A tenth of a pixel is far below what either hint is right to.
    np.testing.assert_allclose(place(found["homography"]), place(MATRIX), atol=0.1)
    assert found["warnings"] == []
    files = () if hint == "zoom" else (tmp_path / hint,)
    assert_provenance(found, "pose", near, far, curves, *files)


def test_a_mirrored_follow_up_is_judged_like_the_others_if_that_is_said(
    command: Command, near: Path, far: Path, curves: Path, tmp_path: Path
) -> None:
    mirrored = tmp_path / "mirrored.tif"
    tifffile.imwrite(mirrored, np.ascontiguousarray(tifffile.imread(far)[:, ::-1]))
    asked = ("--curves", curves, "--min-dprime", 1.0, "--json")
    assert "--mirrored" in command.refused(1, "pose", near, mirrored, *asked)
    done = command.done("pose", near, mirrored, *asked, "--mirrored")
    found = json.loads(done.out)
    flip = np.array([[-1.0, 0, FAR[1] - 1], [0, 1, 0], [0, 0, 1]])
    back = np.array(found["homography"]) @ flip
    np.testing.assert_allclose(place(back), place(MATRIX), atol=0.1)
    assert found["zoom_max"] == pytest.approx(ZOOM, abs=0.01)
    assert found["is_accepted"] is True


def test_a_follow_up_from_nearer_is_judged_like_one_from_the_same_distance(
    command: Command, near: Path, far: Path, curves: Path
) -> None:
    asked = ("--curves", curves, "--min-dprime", 1.0, "--json")
    done = command.done("pose", far, near, *asked)
    found = json.loads(done.out)
    assert found["zoom_max"] == pytest.approx(1 / ZOOM, abs=0.01)
    # Nothing is lost on a follow-up that resolves more than its reference: d' is that at zoom 1.
    assert found["dprime_decisive"] == pytest.approx(curve().dprime[0])
    assert found["is_accepted"] is True
    back = np.linalg.inv(np.array(found["homography"]))
    np.testing.assert_allclose(place(back), place(MATRIX), atol=0.1)


def test_a_mask_of_another_size_is_one_line(
    command: Command, near: Path, far: Path, curves: Path, tmp_path: Path
) -> None:
    tifffile.imwrite(tmp_path / "mask.tif", np.zeros((12, 16), np.uint8))
    asked = ("pose", near, far, "--curves", curves, "--min-dprime", 1.0)
    err = command.refused(1, *asked, "--mask", tmp_path / "mask.tif")
    assert "mask.tif: 16 x 12 px, but " in err
    assert err.count("\n") == 1
