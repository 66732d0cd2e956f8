"""Scenes with depth, as the functions of the library and the commands show them."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from analysis.changes import describe_depth
from benchmarks.truth.depth import depth_pair
from calibration.geometry import GeometryCalibration
from simulation.arrays import Float32Array
from standoff.library.changes import DEPTH_FILES, ComparedPhotographs
from tests.analysis.detectability.test_curves import curve
from tests.calibration.known import known
from tests.calibration.parallax.test_parallax import FARTHER, FRAME, NEAR, photographs, plates
from tests.standoff.library.test_detection_limit_options import geometry

pytestmark = pytest.mark.slow

ROWS, COLS = FRAME


@cache
def with_depth() -> tuple[Float32Array, Float32Array]:
    return photographs(depth_pair(plates(), NEAR, FARTHER))


@cache
def flat() -> tuple[Float32Array, Float32Array]:
    return photographs(depth_pair(replace(plates(), plates=()), NEAR, FARTHER))


def camera(**others: object) -> GeometryCalibration:
    """Which took the reference from 1200 mm, where a pixel is 1 mm."""
    own = {"heights_mm": (1180.0,), "scale_px_per_mm": (1.0,), "pupil_offset_mm": 20.0}
    lens = {"focal_length_px": NEAR.focal_px, "width_px": COLS, "height_px": ROWS}
    return geometry(**{**own, **lens, **others})


@cache
def compared() -> ComparedPhotographs:
    limit = standoff.DetectionLimitOptions(geometry=camera())
    return standoff.find_changes(*with_depth(), limit=limit)


def test_a_geometry_gives_heights_in_mm(tmp_path: Path) -> None:
    found = compared()
    found.write(tmp_path)
    depth, error = (tifffile.imread(tmp_path / name) for name in DEPTH_FILES[2:])
    assert depth.shape == error.shape == FRAME
    truth = depth_pair(plates(), NEAR, FARTHER).height_px
    is_plate = np.isfinite(error) & (truth > 50)
    height = known(found.depth).height_mm
    assert np.median(np.abs(height - truth)[is_plate]) < 6.0
    # What stands higher is nearer to the camera.
    is_ground = np.isfinite(error) & (truth == 0)
    assert np.median(depth[is_ground]) - np.median(depth[is_plate]) > 40
    stored = standoff.read_changes(tmp_path / "changes.json")
    assert stored == found.summary
    in_mm = known(known(stored.parallax).heights)
    assert in_mm.high_mm == pytest.approx(float(np.nanpercentile(height, 99)), rel=1e-4)
    said = known(describe_depth(stored))
    assert f"{in_mm.high_mm:+.3g} mm above the plane" in said
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "Height above the plane of the pose" in page
    assert "distance between the two cameras" in page


def test_heights_of_an_earlier_result_do_not_stay(tmp_path: Path) -> None:
    compared().write(tmp_path)
    standoff.find_changes(*with_depth()).write(tmp_path)
    assert [(tmp_path / name).exists() for name in DEPTH_FILES] == [True, True, False, False]


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"focal_length_px": None}, "the geometry has no focal length"),
        ({"width_px": 780}, "the geometry is of frames of 780 x 180 px, but a photograph has 240"),
    ],
)
def test_why_there_are_no_heights_is_said(stated: dict[str, object], said: str) -> None:
    limit = standoff.DetectionLimitOptions(geometry=camera(**stated))
    found = standoff.find_changes(*with_depth(), limit=limit)
    assert found.depth is None
    assert known(found.summary.parallax).heights is None
    assert [one for one in found.summary.warnings if said in one]


def test_of_a_flat_scene_there_are_none_and_nothing_is_said() -> None:
    limit = standoff.DetectionLimitOptions(geometry=camera(focal_length_px=None))
    found = standoff.find_changes(*flat(), limit=limit)
    assert (found.depth, found.summary.parallax) == (None, None)
    assert not [one for one in found.summary.warnings if "depth" in one]


def test_a_pose_says_what_parallax_costs_and_where_to_stand() -> None:
    judged = standoff.judge_pose(*with_depth(), curve(), 1.0)
    cost = known(judged.summary.parallax)
    assert known(judged.to_json()["parallax"])["range_px"] == cost.range_px
    assert 0 < cost.hidden < 0.5
    # The reference was taken from straight above: against the direction in which this one leans.
    there = FARTHER.rotation @ ((NEAR.centre - FARTHER.centre) * [1, 1, -1])
    assert known(cost.move) == pytest.approx(tuple(there[:2] / np.hypot(*there[:2])), abs=0.05)
    assert cost.in_line_range_px < 0.5 * cost.range_px
    assert "hidden" in judged.plot().axes[0].get_title()
    assert np.isnan(judged.quality.d_prime).any()

    plane = standoff.judge_pose(*with_depth(), curve(), 1.0, flat=True)
    assert plane.summary.parallax is None
    assert not np.isnan(plane.quality.d_prime[plane.quality.sampling.inside]).any()


def test_a_pose_before_a_flat_scene_is_judged_as_a_plane_to_the_last_digit() -> None:
    judged, plane = (
        standoff.judge_pose(*flat(), curve(), 1.0, flat=is_flat) for is_flat in (False, True)
    )
    assert judged.summary.parallax is None
    assert judged.summary.model_copy(update={"provenance": None}) == plane.summary.model_copy(
        update={"provenance": None}
    )


def test_a_registration_holds_the_parallax_and_is_otherwise_that_of_a_plane() -> None:
    found, plane = (standoff.register(*with_depth(), depth=wanted) for wanted in (True, False))
    parallax = known(found.parallax)
    y, x = parallax.pose.followup_places_px()
    truth = depth_pair(plates(), NEAR, FARTHER)
    seen = truth.is_seen & known(parallax.pose.followup_seen())
    assert np.median(np.hypot(y - truth.places_px[0], x - truth.places_px[1])[seen]) < 0.15
    assert "the scene has depth" in found.warnings[-1]
    assert replace(found, parallax=None, warnings=found.warnings[:-1]) == plane
    assert plane.parallax is None
    assert standoff.register(*flat(), depth=True).parallax is None
