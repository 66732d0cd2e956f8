"""What a capture is warned of, and drift over a session."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.special import ndtr

from acquisition.capture._quality import _estimate_motion, check_capture, drift_between
from acquisition.session._capture_files import CaptureImages
from acquisition.session._record import CaptureRecord
from tests.acquisition.records import RECORD

FRAMES = 10
ROWS, COLS = 80, 100
READ_NOISE_DN, DN_PER_E = 2.4, 0.2
BLACK_DN, MAX_DN = 64.0, 4095.0
GOOD = replace(RECORD, saturated_pixels=0, focus_value=0.002, frames_used=FRAMES)
EDGE_DN = BLACK_DN + 600 + 2400 * ndtr((np.arange(COLS) - 49.3) / 0.8)[None, :]


def frames(shifts_px: NDArray[np.float64], seed: int = 7, flicker: float = 0.0) -> CaptureImages:
    """Frames of an edge that moved by so much, with shot and read noise."""
    rng = np.random.default_rng(seed)
    stack = []
    for shift_px in shifts_px:
        lit = 600 + 2400 * ndtr((np.arange(COLS) - 49.3 - shift_px) / 0.8)
        lit = np.tile(lit * (1 + flicker * rng.standard_normal()), (ROWS, 1))
        noise_dn = np.sqrt(READ_NOISE_DN**2 + DN_PER_E * lit)
        stack.append(np.rint(BLACK_DN + lit + noise_dn * rng.standard_normal(lit.shape)))
    levels = np.array(stack)
    return images(levels.mean(0), levels.var(0, ddof=1))


def images(
    mean_dn: NDArray[np.float64],
    variance_dn2: NDArray[np.float64] | None = None,
    record: CaptureRecord = GOOD,
) -> CaptureImages:
    if variance_dn2 is None:
        variance_dn2 = np.full(mean_dn.shape, 100.0)
    return CaptureImages(
        mean_dn=mean_dn.astype(np.float32),
        variance_dn2=variance_dn2.astype(np.float32),
        record=record,
    )


def problems(capture: CaptureImages, *series: CaptureRecord) -> list[tuple[str, bool]]:
    return [(f.problem, f.asks_retake) for f in check_capture(capture, series)]


def level(level_dn: float, **changes: object) -> CaptureImages:
    record = replace(GOOD, **changes)  # type: ignore[arg-type]  # fields of a record
    return images(np.full((ROWS, COLS), level_dn), record=record)


@pytest.mark.parametrize("seed", range(5))
def test_a_still_picture_did_not_move_though_its_lamp_flickers(seed: int) -> None:
    assert problems(frames(np.zeros(FRAMES), seed)) == []
    assert problems(frames(np.zeros(FRAMES), seed, flicker=0.01)) == []


@pytest.mark.parametrize(("rms_px", "asks_retake"), [(0.2, False), (0.6, True)])
def test_a_picture_that_trembles_is_found_and_measured(rms_px: float, asks_retake: bool) -> None:
    shifts_px = rms_px * np.array([1.0, -1.0] * 5) * np.sqrt(0.9)  # rms with N - 1
    capture = frames(shifts_px)
    assert problems(capture) == [("motion", asks_retake)]
    assert capture.variance_dn2 is not None
    motion = _estimate_motion(
        capture.mean_dn, capture.variance_dn2, FRAMES, black_level_dn=BLACK_DN, max_level_dn=MAX_DN
    )
    # Central differences of a sharp edge, and its blur by the motion, make it no exact measure:
    # as much as a pixel comes out too large.
    assert 0.65 * rms_px < motion.rms_px < 2.5 * rms_px


@settings(max_examples=25, deadline=None)
@given(gain=st.floats(0.2, 1.0), seed=st.integers(0, 100))
def test_scaling_the_light_does_not_change_the_motion(gain: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    variance_dn2 = rng.uniform(50, 60, EDGE_DN.shape) + 0.01 * np.gradient(EDGE_DN, axis=1) ** 2
    mean_dn, variance_dn2 = (np.tile(a, (ROWS, 1)) for a in (EDGE_DN, variance_dn2))
    one = _estimate_motion(mean_dn, variance_dn2, 10, black_level_dn=BLACK_DN, max_level_dn=MAX_DN)
    other = _estimate_motion(
        gain * mean_dn,
        gain**2 * variance_dn2,
        10,
        black_level_dn=gain * BLACK_DN,
        max_level_dn=gain * MAX_DN,
    )
    assert other.variance_px2 == pytest.approx(one.variance_px2, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("mean_dn", [0.0, 500.0, 4095.0])
def test_a_picture_without_gradient_tells_nothing_of_motion(mean_dn: float) -> None:
    flat = np.full((ROWS, COLS), mean_dn)
    motion = _estimate_motion(flat, flat, 10, black_level_dn=BLACK_DN, max_level_dn=MAX_DN)
    assert (motion.rms_px, motion.variance_px2) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (0, []),
        (1, [("saturated", False)]),
        (79, [("saturated", False)]),
        (80, [("saturated", True)]),
    ],
)
def test_saturated_pixels_are_counted_against_the_frame(
    pixels: int, expected: list[tuple[str, bool]]
) -> None:
    assert problems(level(2000.0, saturated_pixels=pixels)) == expected  # of 8000


def test_a_whole_frame_that_is_saturated_is_a_hundred_percent() -> None:
    """After minutes of exposure every pixel is white: it said 1e+02 %."""
    findings = check_capture(level(2000.0, saturated_pixels=8000), ())
    assert any("8000 pixels (100 %)" in each.text for each in findings)


@pytest.mark.parametrize(
    ("level_dn", "expected"),
    [
        (470.0, []),  # 10.07 % of 4031 DN
        (460.0, [("under-exposed", False)]),
        (190.0, [("under-exposed", False)]),
        (180.0, [("under-exposed", True)]),
        (10.0, [("under-exposed", True)]),
    ],
)
def test_too_little_light_is_found(level_dn: float, expected: list[tuple[str, bool]]) -> None:
    assert problems(level(level_dn)) == expected


@pytest.mark.parametrize("kind", ["flat", "dark"])
def test_flat_and_dark_captures_may_be_extreme(kind: str) -> None:
    assert problems(level(4095.0, kind=kind, saturated_pixels=8000)) == []
    assert problems(level(64.0, kind=kind)) == []


def test_a_drop_of_focus_is_seen_against_the_nearest_height_of_the_same_orientation() -> None:
    near = replace(GOOD, index=1, uid="near", height_mm=123.0)
    far = replace(GOOD, index=2, uid="far", height_mm=300.0, focus_value=0.02)
    turned = replace(near, uid="turned", orientation_deg=0.0, focus_value=0.02)
    other = replace(near, uid="other", target="coins", focus_value=0.02)
    itself = replace(GOOD, focus_value=0.02)
    for value, expected in (
        (0.0018, []),
        (0.0013, [("focus", False)]),
        (0.0007, [("focus", True)]),
    ):
        capture = level(2000.0, focus_value=value)
        assert problems(capture, near, far, turned, other, itself) == expected
    assert problems(level(2000.0, focus_value=0.0001)) == []


def test_a_texture_may_lose_focus_value_with_the_square_of_the_height() -> None:
    far = replace(GOOD, uid="far", height_mm=2 * GOOD.height_mm)
    assert problems(level(2000.0, focus_value=0.75 * 0.002 / 4), far) == []
    assert problems(level(2000.0, focus_value=0.65 * 0.002 / 4), far) == [("focus", False)]


@given(
    level_dn=st.floats(0, 4095),
    saturated=st.integers(0, 8000),
    focus=st.floats(0, 1),
    expected=st.floats(0, 1),
)
@settings(max_examples=50, deadline=None)
def test_every_finding_is_one_line_and_each_problem_is_named_once(
    level_dn: float, saturated: int, focus: float, expected: float
) -> None:
    capture = level(level_dn, saturated_pixels=saturated, focus_value=focus)
    found = check_capture(capture, [replace(GOOD, uid="x", focus_value=expected)])
    assert len({f.problem for f in found}) == len(found)
    assert all(f.text and "\n" not in f.text for f in found)


DRIFT_BLACK_DN = 64.0


def spot(x_px: float, y_px: float, light: float = 1.0) -> NDArray[np.float64]:
    rows, cols = np.indices((50, 70))
    squared = (cols - 41 - x_px) ** 2 + (rows - 19 - y_px) ** 2
    return DRIFT_BLACK_DN + light * (300 + 2000 * np.exp(-squared / (2 * 4.0**2)))


@settings(max_examples=40, deadline=None)
@given(x_px=st.floats(-0.5, 0.5), y_px=st.floats(-0.5, 0.5), light=st.floats(0.8, 1.25))
def test_shift_and_change_of_light_are_found_apart(x_px: float, y_px: float, light: float) -> None:
    drift = drift_between(spot(0, 0), spot(x_px, y_px, light), black_level_dn=DRIFT_BLACK_DN)
    assert drift.level == pytest.approx(light - 1, abs=0.01)
    assert drift.shift_x_px == pytest.approx(x_px, abs=0.02)
    assert drift.shift_y_px == pytest.approx(y_px, abs=0.02)


def test_along_an_edge_nothing_is_claimed() -> None:
    def edge(shift_px: float) -> NDArray[np.float64]:
        return np.tile(DRIFT_BLACK_DN + 2000 * ndtr((np.arange(80) - 40 - shift_px) / 1.5), (30, 1))

    drift = drift_between(edge(0.0), edge(0.3), black_level_dn=DRIFT_BLACK_DN)
    assert drift.shift_x_px == pytest.approx(0.3, rel=0.1)
    assert drift.shift_y_px == pytest.approx(0.0, abs=1e-6)


def test_a_drift_that_matters_says_what_to_do() -> None:
    still = drift_between(spot(0, 0), spot(0, 0), black_level_dn=DRIFT_BLACK_DN)
    assert not still.is_notable
    assert "warm up" not in still.text
    moved = drift_between(spot(0, 0), spot(0.3, 0, 0.97), black_level_dn=DRIFT_BLACK_DN)
    assert moved.is_notable
    assert "-3.0" in moved.text or "-2.9" in moved.text
    assert "warm up" in moved.text


@pytest.mark.parametrize("level_dn", [0.0, DRIFT_BLACK_DN, 900.0])
def test_pictures_without_structure_have_no_shift(level_dn: float) -> None:
    flat = np.full((9, 9), level_dn)
    drift = drift_between(flat, flat, black_level_dn=DRIFT_BLACK_DN)
    assert (drift.level, drift.shift_px) == (0.0, 0.0)


def test_pictures_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError):
        drift_between(np.zeros((3, 4)), np.zeros((4, 3)), black_level_dn=0)
