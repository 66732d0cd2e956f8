"""Movements on fields that are known at every place: a sum of waves, discs, edges, spots."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import erf

from analysis.changes._movements import ChangedRegion, Movement, find_movements
from analysis.changes._trial import Images, Trial, shift_information
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import smoothed_noise, smoothed_spot

SHAPE = (70, 90)
SMOOTHING_PX = 1.0
SD_DN = 0.5
THRESHOLD_SD = 5.0
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)

Field = Callable[[FloatArray, FloatArray], FloatArray]


def waves(seed: int, height_dn: float) -> Field:
    """A texture that is known between the pixels too: 60 waves of 6 to 40 px."""
    rng = np.random.default_rng(seed)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 60))
    freq = 1 / np.exp(rng.uniform(np.log(6.0), np.log(40.0), 60))

    def levels(y: FloatArray, x: FloatArray) -> FloatArray:
        total = np.zeros(np.shape(y))
        for f, a, p in zip(freq, angle, phase, strict=True):
            total += np.cos(2 * np.pi * f * (np.cos(a) * x + np.sin(a) * y) + p)
        return np.asarray(height_dn * total / np.sqrt(30))

    return levels


def disc(y_px: float, x_px: float, radius_px: float) -> FloatArray:
    """How much a disc with a border as soft as the smoothing covers."""
    inside = radius_px - np.hypot(Y - y_px, X - x_px)
    return np.asarray((1 + erf(inside / (SMOOTHING_PX * np.sqrt(2)))) / 2)


def moved_thing(
    ground: Field, thing: Field, shift: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Before and after of a disc, of 7 px radius, with its own texture."""

    def image(y: float, x: float) -> FloatArray:
        cover = disc(34.0 + y, 44.0 + x, 7.0)
        return np.asarray((1 - cover) * ground(Y, X) + cover * (60 + thing(Y - y, X - x)))

    return image(0.0, 0.0), image(*shift)


def compared(before: FloatArray, after: FloatArray, seed: int | None = 1) -> Images:
    """The two, the one after with all of the noise."""
    noise = np.zeros(SHAPE)
    if seed is not None:
        noise = SD_DN * smoothed_noise(np.random.default_rng(seed), SHAPE, SMOOTHING_PX)
    return Images(
        before_dn=before,
        after_dn=after + noise,
        sd_dn=np.full(SHAPE, SD_DN),
        valid=np.ones(SHAPE, dtype=np.bool_),
        smoothing_px=SMOOTHING_PX,
    )


def regions(images: Images) -> list[ChangedRegion]:
    """The connected pixels of one sign beyond the threshold, the strongest first."""
    z = (images.after_dn - images.before_dn) / images.sd_dn
    found = []
    for sign in (1, -1):
        count, labels = cv2.connectedComponents((sign * z > THRESHOLD_SD).astype(np.uint8))
        for label in range(1, count):
            rows, cols = np.nonzero(labels == label)
            top = int(np.argmax(np.abs(z[rows, cols])))
            found.append(
                ChangedRegion(
                    row=int(rows[top]), col=int(cols[top]), sign=sign, rows=rows, cols=cols
                )
            )
    return sorted(found, key=lambda one: -abs(float(z[one.row, one.col])))


def movements(images: Images) -> tuple[Movement, ...]:
    return find_movements(images, regions(images))


def test_a_pixel_beside_a_change_so_large_that_some_of_it_stands_for_all_has_not_moved() -> None:
    images = compared(0 * Y, 40 * disc(35.0, 35.0, 30.0))
    (large,) = regions(images)
    for row in range(20, 50, 3):
        at = np.array([row]), np.array([72])
        pixel = ChangedRegion(row=row, col=72, sign=-large.sign, rows=at[0], cols=at[1])
        assert find_movements(images, [large, pixel]) == ()


def test_without_changes_there_is_no_movement() -> None:
    assert find_movements(compared(0 * Y, 0 * Y), []) == ()


@pytest.mark.slow
@pytest.mark.parametrize("shift", [(0.4, -0.7), (-2.2, 1.3), (3.0, 2.0)])
def test_a_ground_that_moved_is_explained_with_its_shift(shift: tuple[float, float]) -> None:
    ground = waves(3, 25.0)
    images = compared(ground(Y, X), ground(Y - shift[0], X - shift[1]))
    found = movements(images)
    explained = {index for movement in found for index in movement.regions}
    pixels = [len(one.rows) for one in regions(images)]
    assert sum(pixels[index] for index in explained) > 0.97 * sum(pixels)
    largest = max(found, key=lambda one: len(one.regions))
    # The stated errors are 0.1 px at least.
    assert largest.displacement_px == pytest.approx(shift, abs=0.3)


@pytest.mark.parametrize("shift", [(1.0, 0.5), (-1.5, 2.0), (0.0, 3.0)])
def test_a_thing_that_moved_a_little_is_one_movement(shift: tuple[float, float]) -> None:
    images = compared(*moved_thing(waves(5, 8.0), waves(6, 12.0), shift))
    assert len(regions(images)) > 1
    (found,) = movements(images)
    assert found.displacement_px == pytest.approx(shift, abs=0.3)


@pytest.mark.parametrize("shift", [(0.0, 15.0), (-12.0, 5.0)])
def test_a_thing_that_moved_beyond_its_width_is_one_movement(shift: tuple[float, float]) -> None:
    images = compared(*moved_thing(waves(5, 8.0), waves(6, 12.0), shift))
    (found,) = movements(images)
    assert found.displacement_px == pytest.approx(shift, abs=0.3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("sigma_px", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("height", [1.4, 6.0])
def test_a_spot_is_no_movement(sign: float, sigma_px: float, height: float) -> None:
    """Neither on a texture nor on an edge, from what is just detectable on."""
    peak = height * THRESHOLD_SD * SD_DN * (sigma_px**2 + SMOOTHING_PX**2) / sigma_px**2
    ground = waves(8, 20.0)(Y, X) + 80 * disc(20.0, 30.0, 25.0)
    for place in ((34.3, 52.1), (45.0, 30.2), (20.0, 55.1)):
        spot = smoothed_spot(SHAPE, place, sign * peak, sigma_px, SMOOTHING_PX)
        images = compared(ground, ground + spot)
        assert regions(images)
        assert movements(images) == ()


@pytest.mark.parametrize("is_first", [True, False])
def test_a_thing_that_appeared_or_vanished_did_not_move(is_first: bool) -> None:
    ground, thing = waves(5, 8.0)(Y, X), waves(6, 12.0)(Y, X)
    cover = disc(34.0, 44.0, 7.0)
    covered = (1 - cover) * ground + cover * (60 + thing)
    pair = (ground, covered) if is_first else (covered, ground)
    assert movements(compared(*pair)) == ()


def test_along_an_edge_the_shift_is_known_less() -> None:
    bent = 44 + (Y - 35) ** 2 / 300
    found = movements(compared(10 * erf((X - bent) / 2), 10 * erf((X - bent - 1) / 2)))[0]
    y_err, x_err = found.displacement_err_px
    assert found.displacement_px[1] == pytest.approx(1.0, abs=4 * x_err)
    assert 1.3 * x_err < y_err


def test_a_straight_edge_that_moved_is_not_told_from_a_line_on_it() -> None:
    assert movements(compared(40 * erf((X - 44) / 2), 40 * erf((X - 45) / 2))) == ()


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(
    y=st.floats(-2.5, 2.5).filter(lambda value: abs(value) > 0.5),
    x=st.floats(-2.5, 2.5),
    seed=st.integers(0, 20),
)
def test_backwards_in_time_everything_moves_the_other_way(y: float, x: float, seed: int) -> None:
    before, after = moved_thing(waves(seed, 8.0), waves(seed + 100, 12.0), (y, x))
    ahead = movements(compared(before, after, None))
    back = movements(compared(after, before, None))
    if len(ahead) == len(back) == 1:
        assert np.add(ahead[0].displacement_px, back[0].displacement_px) == pytest.approx(
            (0.0, 0.0), abs=0.3
        )


def test_what_touches_the_border_or_unusable_pixels_is_judged_too() -> None:
    before, after = moved_thing(waves(5, 8.0), waves(6, 12.0), (1.0, 0.5))
    for crop in (np.s_[34:, 44:], np.s_[:36, :40]):
        images = compared(before, after)
        valid = np.zeros(SHAPE, dtype=np.bool_)
        valid[crop] = True
        cut = Images(
            before_dn=np.where(valid, images.before_dn, 0),
            after_dn=np.where(valid, images.after_dn, 0),
            sd_dn=np.where(valid, images.sd_dn, np.inf),
            valid=valid,
            smoothing_px=SMOOTHING_PX,
        )
        for found in find_movements(cut, regions(cut)):
            assert np.isfinite(found.displacement_px).all()


@pytest.mark.parametrize("least", [4.0, 0.0, -3.0])
def test_what_is_known_of_a_shift_is_finite_whatever_the_errors_leave(least: float) -> None:
    # Closed form along the axes: 1 / (c / n^2 + 0.1^2), c at least a millionth.
    normal, correlated = np.diag([10.0, 20.0]), np.diag([5.0, least])
    found = shift_information(normal, correlated)
    expected = [1 / (5.0 / 100 + 0.01), 1 / (max(least, 1e-6) / 400 + 0.01)]
    np.testing.assert_allclose(found, np.diag(expected), rtol=1e-9, atol=1e-9)


@given(
    along_deg=st.floats(0.0, 180.0),
    off_deg=st.floats(-5.0, 5.0),
    size=st.floats(0.0, 6.0),
    seen=st.floats(-9.0, 0.0),
)
def test_along_an_edge_a_shift_is_as_good_as_unknown_and_across_it_known(
    along_deg: float, off_deg: float, size: float, seen: float
) -> None:
    # Errors that correlate a little off the edge made the variance along it 1e14 px2, and what was
    # left of that across it came out singular, or negative.
    def outer(deg: float) -> FloatArray:
        axis = np.array([np.cos(np.deg2rad(deg)), np.sin(np.deg2rad(deg))])
        return np.outer(axis, axis)

    across, slope2 = outer(along_deg + 90.0), 10.0**size
    normal = slope2 * (across + 10.0**seen * outer(along_deg)) + 1e-6 * np.eye(2)
    information = shift_information(normal, 30.0 * slope2 * outer(along_deg + 90.0 + off_deg))
    variances = np.linalg.eigvalsh(np.linalg.inv(information))
    assert 0.999 * 0.1**2 < variances[0] <= variances[1] < 1.001 * 1000.0**2
    assert (np.diag(np.linalg.inv(information)) > 0).all()


@pytest.mark.parametrize("radius_px", [3.0, 6.0])
@pytest.mark.parametrize("is_put_in", [False, True])
def test_what_is_gone_from_a_plain_ground_or_new_on_it_has_not_moved(
    radius_px: float, is_put_in: bool
) -> None:
    """A plain ground is found everywhere around, and explains nothing: a mast before the sky."""
    sky = 200.0 - 0.05 * Y
    mast = np.clip((radius_px - np.abs(X - 44.0)) / 2 + 0.5, 0, 1) * (Y > 20)
    thing = sky - 60.0 * mast
    before, after = (sky, thing) if is_put_in else (thing, sky)
    assert movements(compared(before, after)) == ()


def test_a_thing_that_moved_over_a_plain_ground_by_more_than_its_size_has_moved() -> None:
    sky = 200.0 - 0.05 * Y
    before, after = sky - 60 * disc(30.0, 30.0, 4.0), sky - 60 * disc(36.0, 42.0, 4.0)
    (found,) = movements(compared(before, after))
    assert len(found.regions) == 2
    assert found.displacement_px == pytest.approx((6.0, 12.0), abs=0.3)


def test_pixels_that_do_not_differ_are_left_by_a_spot_without_anything() -> None:
    """As of a thing whose colour alone has changed: its brightness is the same to the bit."""
    spot = smoothed_spot(SHAPE, (44.0, 34.0), 40.0, 2.0, SMOOTHING_PX)
    images = compared(waves(3, 6.0)(Y, X), waves(3, 6.0)(Y, X) + spot, seed=None)
    rows, cols = np.nonzero(spot > 1.0)
    trial = Trial(images, rows, cols, 8.0)
    pixels = np.column_stack([Y.ravel(), X.ravel(), *np.zeros((6, Y.size))])
    assert trial.spot_cost_on(pixels) == 0.0
    assert trial.spot_cost_on(pixels[:0]) == 0.0
    pixels[:, 3], pixels[:, 4] = SD_DN, spot.ravel() / SD_DN
    assert 0 < trial.spot_cost_on(pixels) < 0.02 * float((pixels[:, 4] ** 2).sum())
