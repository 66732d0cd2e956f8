"""Pixels at an end of the scale: what they show is at least what differs."""

import cv2
import numpy as np
import pytest

from analysis.changes import ChangeOptions, find_changes
from analysis.errors import OverlapError
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray
from tests.shipped import shipped


def chart(seed: int = 3) -> FloatArray:
    """A drawing of two levels, no line of which any code of ours drew: scikit-image's horse."""
    return np.where(shipped("horse")[:320, :390] > 0, 255.0, 0.0)


def test_a_word_that_is_gone_from_clipped_paper_is_found() -> None:
    page = shipped("page")
    page = np.minimum(page * 1.35, 255.0)
    assert np.mean(page == 255) > 0.1
    erased = page.copy()
    erased[95:106, 180:204] = 255.0
    result = find_changes(page, erased, options=ChangeOptions(white_level_dn=(255.0, 255.0)))
    assert len(result.summary.changes) == 1
    (word,) = result.summary.changes
    assert (word.what, abs(word.x_px - 191.5) < 5, abs(word.y_px - 100) < 5) == ("gone", True, True)


def test_two_levels_are_compared_with_each_other() -> None:
    before, after = chart(), chart()
    # A spot of either kind, amid the other level.
    after[40:48, 40:48] = 255.0 - before[44, 44]
    after[160:168, 200:208] = 255.0 - before[164, 204]
    found = find_changes(before, after).summary
    places = sorted((round(one.x_px), round(one.y_px)) for one in found.changes)
    assert [(abs(x - 43.5) < 2, abs(y - 43.5) < 2) for x, y in places[:1]] == [(True, True)]
    assert len(places) == 2
    assert find_changes(before, before).summary.changes == ()


def test_where_both_are_at_one_end_nothing_is_compared() -> None:
    rng = np.random.default_rng(1)
    scene = shipped("camera")[:300, :300] * 0.8 + 20
    scene[100:150, 100:160] = 400.0
    before, after = (np.clip(np.rint(scene + rng.normal(0, 2, scene.shape)), 0, 255) for _ in "ab")
    result = find_changes(before, after, options=ChangeOptions(white_level_dn=(255.0, 255.0)))
    assert not result.valid[105:145, 105:155].any()
    assert result.valid[20:80, 20:80].all()
    assert result.summary.changes == ()


def test_what_is_brighter_than_white_is_a_change_of_at_least_so_much() -> None:
    rng = np.random.default_rng(2)
    scene = shipped("camera")[:300, :300] * 0.7 + 20
    lamp = scene.copy()
    lamp[200:210, 200:210] = 900.0
    before, after = (
        np.clip(np.rint(one + rng.normal(0, 2, scene.shape)), 0, 255) for one in (scene, lamp)
    )
    options = ChangeOptions(white_level_dn=(255.0, 255.0))
    found = find_changes(before, after, options=options).summary
    assert len(found.changes) == 1
    assert found.changes[0].amplitude_dn > 255 - scene[200:210, 200:210].max() - 5


def test_where_the_ends_leave_nothing_it_is_said() -> None:
    dots = np.zeros((160, 160))
    dots[::6, ::6] = 255.0
    dots[3::6] = 100.0
    # Half a pixel aside every place is within reach of both ends.
    aside = np.eye(3)
    aside[:2, 2] = 0.5
    pose = DistortedPose(
        matrix=aside, k1=0.0, reference_shape=dots.shape, followup_shape=dots.shape
    )
    options = ChangeOptions(pose=pose, white_level_dn=(255.0, 255.0))
    with pytest.raises(OverlapError, match="at an end of the scale, or beside one"):
        find_changes(dots, dots, options=options)


def drawn_from_aside(drawing: FloatArray, pose: FloatArray) -> FloatArray:
    """The drawing as a scanner of two levels sees it at another pose, by OpenCV."""
    large = cv2.resize(drawing, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    seen = cv2.warpPerspective(
        cv2.GaussianBlur(large, (0, 0), 2.0),
        pose @ np.diag([1 / 3, 1 / 3, 1.0]),
        drawing.shape[::-1],
        borderValue=255,
    )
    return np.where(seen > 127, 255.0, 0.0)


def test_two_drawings_from_aside_are_compared_beside_the_steps_of_their_outlines() -> None:
    turned = np.array([[0.97, -0.034, 7.0], [0.034, 0.97, -3.0], [1e-5, 2e-5, 1.0]])
    drawing = chart()
    spotted = drawing.copy()
    assert (drawing[70:80, 80:90] == 255).all()
    spotted[70:80, 80:90] = 0.0
    step_dn = np.ones(drawing.shape, dtype=np.float32)
    options = ChangeOptions(white_level_dn=(255.0, 255.0), step_dn=(step_dn, step_dn))
    before = drawn_from_aside(drawing, np.eye(3))
    same, other = (
        find_changes(before, drawn_from_aside(one, turned), options=options).summary
        for one in (drawing, spotted)
    )
    # Without the steps, every second outline had changed: 24 entries.
    assert len(same.changes) <= 1
    assert len(other.changes) <= 2
    first = other.changes[0]
    x, y, scale = turned @ (84.5, 74.5, 1.0)
    assert (first.x_px, first.y_px) == pytest.approx((x / scale, y / scale), abs=2)


def test_a_drawing_whose_lines_moved_by_themselves_has_the_pose_at_which_most_did_not() -> None:
    rng = np.random.default_rng(5)
    before = np.full((320, 320), 255.0)
    places = [(20 + 50 * i, 20 + 50 * j) for i in range(6) for j in range(6)]
    after = before.copy()
    for row, col in places:
        before[row : row + 24, col : col + 30] = 0.0
        down, right = rng.integers(-1, 2, 2)
        after[row + down : row + 24 + down, col + right : col + 30 + right] = 0.0
    after[100:108, 6:14] = 0.0
    step_dn = np.ones(before.shape, dtype=np.float32)
    options = ChangeOptions(white_level_dn=(255.0, 255.0), step_dn=(step_dn, step_dn))
    found = find_changes(before, after, options=options).summary
    assert np.allclose(found.homography, np.eye(3), atol=1e-3)
    (one,) = found.changes
    assert np.hypot(one.x_px - 9.5, one.y_px - 103.5) < 3
    assert one.area_px < 120


def test_a_line_of_one_pixel_that_is_gone_from_a_copy_of_a_drawing_is_found() -> None:
    before = chart()
    after = before.copy()
    before[200:230, 300] = 0.0
    assert (after[195:235, 295:306] == 255).all()
    options = ChangeOptions(white_level_dn=(255.0, 255.0))
    (line,) = find_changes(before, after, options=options).summary.changes
    assert line.x_px == pytest.approx(300, abs=1.5)
    assert 200 <= line.y_px < 230
