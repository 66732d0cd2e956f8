"""Parallax of rendered scenes whose truth is known, from the photographs alone.

Photographs are of 180 x 240 px, with noise of 1 DN beside a contrast of 28; cameras stand 60 to
250 px of ground aside, from where plates are displaced by 3 to 17 px, and hills by up to 12.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from benchmarks.truth.depth import DepthPair, DepthScene, Hill, Plate, View, depth_pair
from benchmarks.truth.pairs import FlatScene, scene
from calibration.parallax import Parallax, find_parallax
from calibration.registration import DistortedPose, register_images
from simulation.arrays import BoolArray, Float32Array, FloatArray
from tests.calibration.known import known

FRAME = (180, 240)
BORDER_PX = 8
NEAR, ASIDE = View(), View(x_px=60.0)
TILTED = View(tilt_deg=6.0, bearing_deg=30.0, roll_deg=3.0)
FARTHER = View(distance_px=1500.0, tilt_deg=6.0, bearing_deg=30.0)


@cache
def texture(seed: int) -> FlatScene:
    return scene("texture", FRAME, seed, contrast_dn=28.0)


def plate(x_px: float, y_px: float, height_px: float, *, is_round: bool = False) -> Plate:
    return Plate(
        x_px=x_px,
        y_px=y_px,
        half_width_px=30.0,
        half_height_px=22.0,
        is_round=is_round,
        height_px=height_px,
        texture=texture(2),
    )


def plates() -> DepthScene:
    """Of which none has less than 3 px of parallax, seen from 60 px aside."""
    made = (
        plate(-55.0, -35.0, 80.0, is_round=True),
        plate(50.0, 35.0, 110.0),
        plate(45.0, -45.0, 60.0),
        plate(-50.0, 45.0, 65.0, is_round=True),
    )
    return DepthScene(ground=texture(1), plates=made, frame=FRAME)


def hills() -> DepthScene:
    made = (
        Hill(x_px=-40.0, y_px=-20.0, sigma_px=45.0, height_px=60.0),
        Hill(x_px=60.0, y_px=30.0, sigma_px=35.0, height_px=40.0),
    )
    return DepthScene(ground=texture(1), hills=made, frame=FRAME)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What is true of two photographs, and what was found."""

    pair: DepthPair
    found: Parallax

    def inside(self, off_px: int = BORDER_PX) -> BoolArray:
        """Pixels further from both borders than blurs and censuses reach, or than ``off_px``."""
        rows, cols = FRAME
        own = np.zeros(FRAME, dtype=np.bool_)
        own[off_px:-off_px, off_px:-off_px] = True
        y, x = self.pair.places_px
        there = (y > off_px) & (y < rows - 1 - off_px)
        return np.asarray(own & there & (x > off_px) & (x < cols - 1 - off_px))

    @property
    def said_of(self) -> float:
        """Share that is said to be seen of what both show further than 16 px from borders."""
        return float(np.mean(self.seen[self.pair.is_seen & self.inside(16)]))

    @property
    def errors_px(self) -> FloatArray:
        y, x = self.found.pose.followup_places_px()
        return np.asarray(np.hypot(y - self.pair.places_px[0], x - self.pair.places_px[1]))

    @property
    def seen(self) -> BoolArray:
        return known(self.found.pose.followup_seen())


def photographs(pair: DepthPair) -> tuple[Float32Array, Float32Array]:
    return pair.noisy(np.random.default_rng(0), 1.0)


def found_in(reference: Float32Array, followup: Float32Array) -> Parallax | None:
    return find_parallax(reference, followup, register_images(reference, followup).pose)


VIEWS = {
    "plates_aside": ("plates", NEAR, ASIDE),
    "plates_tilted": ("plates", NEAR, TILTED),
    "plates_farther": ("plates", NEAR, FARTHER),
    "plates_closer": ("plates", FARTHER, NEAR),
    "hills_tilted": ("hills", NEAR, TILTED),
    "hills_farther": ("hills", NEAR, FARTHER),
}
WITH_PLATES = [name for name in VIEWS if name.startswith("plates")]


@cache
def case(name: str) -> Case:
    kind, reference, followup = VIEWS[name]
    pair = depth_pair(plates() if kind == "plates" else hills(), reference, followup)
    return Case(pair=pair, found=known(found_in(*photographs(pair))))


@pytest.mark.slow
@pytest.mark.parametrize("name", VIEWS)
def test_pixels_lie_where_they_are_said_to(name: str) -> None:
    one = case(name)
    both = one.seen & one.pair.is_seen & one.inside()
    errors = one.errors_px[both]
    # Noise of 1 DN in slopes of some 5 DN a pixel, shared by some tens of pixels: .05 px. A plane
    # alone leaves the parallax, some pixels.
    assert np.median(errors) < 0.15
    assert np.percentile(errors, 95) < 0.5
    # Jumps and a band of some 4 px at either side are left out: of four outlines of 220 px each, a
    # quarter of the frame.
    assert one.said_of > 0.65


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_PLATES)
def test_what_the_reference_does_not_show_is_found(name: str) -> None:
    one = case(name)
    hidden = ~one.pair.is_seen & one.inside()
    assert np.count_nonzero(hidden) > 300
    assert np.mean(~one.seen[hidden]) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plates_farther", "plates_closer", "hills_tilted"])
def test_what_the_follow_up_does_not_show_is_found_from_the_reference(name: str) -> None:
    """The inverse pose is that of the photographs exchanged; its truth is rendered anew."""
    kind, reference, followup = VIEWS[name]
    back = depth_pair(plates() if kind == "plates" else hills(), followup, reference)
    found = case(name).found
    one = Case(pair=back, found=replace(found, pose=found.pose.inverse()))
    both = one.seen & back.is_seen & one.inside()
    assert np.median(one.errors_px[both]) < 0.15
    assert np.percentile(one.errors_px[both], 95) < 0.5
    assert one.said_of > 0.65
    hidden = ~back.is_seen & one.inside()
    assert not hidden.any() or np.mean(~one.seen[hidden]) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plates_aside", "plates_tilted", "plates_farther"])
def test_the_epipole_is_the_reference_cameras_centre(name: str) -> None:
    """Seen from the middle of the follow-up's frame, its direction is known."""
    _, reference, followup = VIEWS[name]
    # The centre as the follow-up's camera has it: to the right, down, and ahead.
    apart = reference.centre - followup.centre
    right, down, ahead = followup.rotation @ np.array([apart[0], apart[1], -apart[2]])
    middle_y, middle_x = ((n - 1) / 2 for n in FRAME)
    true = np.array([right * followup.focal_px, down * followup.focal_px])
    x, y, w = case(name).found.epipole_px
    found = np.array([x - w * middle_x, y - w * middle_y])
    cosine = abs(true @ found) / np.linalg.norm(true) / np.linalg.norm(found)
    # Parallax of some 6 px beside errors of .1 px: a hundredth of a radian and a half.
    assert np.degrees(np.arccos(min(cosine, 1.0))) < 1.5
    if ahead > 100:
        # And how far it is, where it is not at infinity: 1200 px times 126 over 300.
        apart_px = np.linalg.norm(found / w)
        assert apart_px == pytest.approx(np.linalg.norm(true / ahead), rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plates_tilted", "hills_tilted", "plates_farther"])
def test_stated_errors_are_right_within_a_factor_of_3(name: str) -> None:
    one = case(name)
    error = one.found.parallax_err_px
    assert one.found.pose.parallax is not None
    assert one.found.pose.parallax.photograph == "followup"
    counts = one.seen & one.pair.is_seen & one.inside() & np.isfinite(error)
    # Along one line and across it: of both, the part along is stated.
    ratio = one.errors_px[counts] / error[counts]
    # A normal variable is within .67 of its deviation half the time; the plane's own errors and
    # the part across come on top of it.
    assert 0.67 / 3 < np.median(ratio) < 0.67 * 3


@pytest.mark.slow
def test_a_flat_scene_has_no_parallax() -> None:
    flat = DepthScene(ground=texture(1), frame=FRAME)
    for followup in (ASIDE, TILTED, FARTHER):
        assert found_in(*photographs(depth_pair(flat, NEAR, followup))) is None


@pytest.mark.slow
def test_two_photographs_of_different_things_have_none() -> None:
    one, other = (DepthScene(ground=texture(n), frame=FRAME).photograph(NEAR) for n in (1, 2))
    for matrix in (np.eye(3), np.array([[1.2, 0.1, -30], [-0.1, 1.2, -9], [0, 0, 1]])):
        pose = DistortedPose(matrix=matrix, k1=0.0, reference_shape=FRAME, followup_shape=FRAME)
        assert find_parallax(one, other, pose) is None


@pytest.mark.slow
@pytest.mark.parametrize(("by_x", "by_y"), [(9.0, 0.0), (0.0, -14.0)])
def test_one_thing_that_moved_on_flat_ground_has_none(by_x: float, by_y: float) -> None:
    """A thing as thin as paper, in another place in the follow-up."""
    ground = DepthScene(ground=texture(1), frame=FRAME)
    before = replace(ground, plates=(plate(-30.0, 10.0, 1e-6),)).photograph(NEAR)
    after = replace(ground, plates=(plate(-30.0 + by_x, 10.0 + by_y, 1e-6),)).photograph(TILTED)
    rng = np.random.default_rng(3)
    noisy = (one + rng.normal(0, 1, FRAME).astype(np.float32) for one in (before, after))
    assert found_in(*noisy) is None


def test_a_pose_that_reduces_at_both_centres_ends() -> None:
    """Tilted and aside: at the middle of either photograph, the other is the finer one."""
    slant, shift = 0.004, np.eye(3)
    shift[:2, 2] = 50.0, 50.0
    lean = np.array([[1.0, 0, 0], [0, 1, 0], [slant, 0, 1]])
    # About the middle the scale is .9; 40 px to the left of it, where the reference has its middle,
    # .9 / (1 - .16)^1.5, which is 1.17.
    to_middle = np.eye(3)
    to_middle[0, 2] = 40 * 0.9 / (1 - 40 * slant)
    scale = np.diag([0.9, 0.9, 1.0])
    matrix = shift @ to_middle @ scale @ lean @ np.linalg.inv(shift)
    pose = DistortedPose(
        matrix=matrix / matrix[2, 2], k1=0.0, reference_shape=(101, 101), followup_shape=(101, 101)
    )
    assert pose.zoom < 1
    assert pose.inverse().zoom < 1
    rng = np.random.default_rng(0)
    one, other = (rng.normal(100, 20, (101, 101)).astype(np.float32) for _ in range(2))
    assert find_parallax(one, other, pose) is None
