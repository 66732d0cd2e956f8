"""``standoff limits`` of a follow-up aimed elsewhere, and of a pose that is known."""

import json
from pathlib import Path

import numpy as np
import pytest

import standoff
from analysis.pose import ViewingCamera
from tests.standoff.conftest import Command

ZOOMS, DPRIMES = [1.0, 1.25, 1.5, 2.0], [6.0, 3.0, 2.0, 1.0]


@pytest.fixture
def curves_file(tmp_path: Path) -> Path:
    curve = {
        "model": "matched",
        "observer": "hotelling",
        "noise_dn": 2.0,
        "contrast_dn": 12.0,
        "signal_sigma_px": 2.0,
        "zoom": ZOOMS,
        "dprime": DPRIMES,
        "dprime_low": DPRIMES,
        "dprime_high": DPRIMES,
        "auc": [1.0, 0.98, 0.92, 0.76],
    }
    path = tmp_path / "curves.json"
    path.write_text(json.dumps({"schema": "standoff.detectability/1", "curves": [curve]}))
    return path


def pose_file(folder: Path, matrix: object, size: tuple[int, int]) -> Path:
    path = folder / "H.json"
    document = {"schema": "standoff.homography/1", "matrix": matrix, "size": size}
    path.write_text(json.dumps(document))
    return path


def test_a_pure_zoom_has_the_d_of_the_curve_everywhere(
    command: Command, curves_file: Path, tmp_path: Path
) -> None:
    # From 1.5 times further away 400 x 300 px show 600 x 450 of the reference's 800 x 600.
    pose = pose_file(tmp_path, [[1.5, 0, 100], [0, 1.5, 75], [0, 0, 1]], (400, 300))
    words = ("limits", "--curves", curves_file, "--min-dprime", 1.9, "--homography", pose)
    found = command.document(*words, "--reference-size", "800x600")
    for name in ("dprime_min", "dprime_median", "dprime_quantile", "dprime_max"):
        assert found[name] == pytest.approx(2.0), name
    assert found["zoom_min"] == found["zoom_max"] == pytest.approx(1.5)
    assert found["zoom_median"] == pytest.approx(1.5)
    assert found["overlap"] == 1.0
    assert found["is_accepted"]
    assert found["reference_size"] == [800, 600]
    assert found["followup_size"] == [400, 300]
    told = command(*words, "--reference-size", "800x600")
    assert told.out.split("\n")[1].startswith("accepted: d' 2 at least, 2 in the median")
    # Of a reference that is as small as the follow-up, it shows 300 / 1.5 of 400 columns, ...
    small = json.loads(command(*words, "--json").out)
    assert small["overlap"] == pytest.approx(0.5 * 0.5, abs=0.02)


def test_a_pose_composed_of_two_agrees_with_the_limits(curves_file: Path) -> None:
    camera = ViewingCamera(focal_length_px=800.0, width_px=640, height_px=480)
    aim_px = (400.0, 200.0)
    limits = standoff.pose_limits(
        curves_file,
        2.0,
        focal_length_px=800.0,
        image_size=(640, 480),
        reference_tilt_deg=8.0,
        direction_deg=40.0,
        aim_px=aim_px,
    )
    zoom = dict(limits.zoom_by_tilt)[10.0]
    assert zoom is not None
    for share, is_accepted in ((0.99, True), (1.02, False)):
        matrix = camera.followup_to_reference(share * zoom, 10.0, 8.0, 40.0, aim_px)
        judged = standoff.judge_homography(matrix, curves_file, 2.0, size=(640, 480))
        assert judged.is_accepted is is_accepted
    assert judged.dprime_median > judged.quality.decisive_d_prime


def test_a_follow_up_aimed_elsewhere_is_in_the_document(
    command: Command, curves_file: Path
) -> None:
    camera = ("--focal-length-px", 800, "--image-size", "640x480")
    words = ("limits", "--curves", curves_file, "--min-dprime", 2, *camera)
    plain = json.loads(command(*words, "--json").out)
    assert plain["aim_px"] is None
    assert plain["aimed_overlap"] is None
    aimed = command.document(*words, "--aim", "480,240")
    assert aimed["aim_px"] == [480, 240]
    assert aimed["aimed_overlap"] == pytest.approx(1 - 160.5 / 640, abs=0.01)
    assert aimed["zoom"] == plain["zoom"]
    assert "aimed at 480,240 px of the reference" in command(*words, "--aim", "480,240").out


def test_a_lens_that_distorts_is_judged_by_its_nearest_homography(
    curves_file: Path, tmp_path: Path
) -> None:
    path = pose_file(tmp_path, [[1.3, 0, 0], [0, 1.3, 0], [0, 0, 1]], (400, 300))
    bent = json.loads(path.read_text()) | {"distortion_k1": -0.01}
    path.write_text(json.dumps(bent))
    found = standoff.judge_homography(path, curves_file, 1.5, reference_size=(520, 390))
    assert any("nearest" in note for note in found.notes)
    assert found.zoom_median == pytest.approx(1.3, rel=0.02)


def test_a_bare_matrix_needs_a_size(curves_file: Path) -> None:
    with pytest.raises(standoff.ArgumentError, match="size"):
        standoff.judge_homography(np.eye(3), curves_file, 2.0)
