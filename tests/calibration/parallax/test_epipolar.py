"""Epipolar geometry beside closed-form cameras and points that are where they are said to be."""

from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.parallax import EpipolarGeometry, epipolar_geometry
from calibration.parallax._correction import Correction
from calibration.registration import DistortedPose, FeatureMatches
from simulation.arrays import BoolArray, FloatArray
from tests.calibration.known import known

FRAME = (300, 400)
FOCAL_PX, DEPTH = 500.0, 10.0
CAMERA = np.array([[FOCAL_PX, 0, 199.5], [0, FOCAL_PX, 149.5], [0, 0, 1.0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Turned:
    """The source's camera: its centre, in units of which the plane is 10 off, and its turn."""

    centre: tuple[float, float, float]
    pan_deg: float = 0.0
    roll_deg: float = 0.0

    @property
    def rotation(self) -> FloatArray:
        pan, roll = radians(self.pan_deg), radians(self.roll_deg)
        about_y = np.array([[cos(pan), 0, -sin(pan)], [0, 1, 0], [sin(pan), 0, cos(pan)]])
        about_z = np.array([[cos(roll), -sin(roll), 0], [sin(roll), cos(roll), 0], [0, 0, 1.0]])
        return np.asarray(about_z @ about_y)

    def seen(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3)."""
        return pinhole((points - np.array(self.centre)) @ self.rotation.T)

    @property
    def epipole(self) -> FloatArray:
        """The centre as the target's camera projects it, homogeneous, of length 1."""
        found = CAMERA @ np.array(self.centre)
        return np.asarray(found / np.linalg.norm(found))

    @property
    def plane(self) -> FloatArray:
        """Target to source pixels of what lies at the plane's depth."""
        to_plane = np.eye(3)
        to_plane[:, 2] -= np.array(self.centre) / DEPTH
        found = CAMERA @ self.rotation @ to_plane @ np.linalg.inv(CAMERA)
        return np.asarray(found / found[2, 2])


def pinhole(points: FloatArray) -> FloatArray:
    seen = points @ CAMERA.T
    return np.asarray(seen[:, :2] / seen[:, 2:])


CAMERAS = {
    "aside": Turned(centre=(0.4, 0.0, 0.0)),
    "aside_and_turned": Turned(centre=(0.3, -0.2, 0.1), pan_deg=1.5, roll_deg=4.0),
    "upwards": Turned(centre=(0.02, 0.35, -0.05), roll_deg=-10.0),
    "forward": Turned(centre=(0.1, 0.05, 2.0)),
    "backward": Turned(centre=(-0.1, 0.1, -2.0), pan_deg=-1.0),
}
BESIDE = [name for name in CAMERAS if name not in ("forward", "backward")]


def points_of(rng: np.random.Generator, count: int, on_plane: float) -> FloatArray:
    """Points (n, 3) that fill the target's frame, a share of them on the plane.

    The others stand out by -10 % to 40 % of its depth.
    """
    pixels = rng.uniform((0, 0), (399, 299), (count, 2))
    depth = np.full(count, DEPTH)
    aside = np.arange(count) >= round(on_plane * count)
    depth[aside] *= rng.uniform(0.6, 1.1, np.count_nonzero(aside))
    rays = np.column_stack([pixels, np.ones(count)]) @ np.linalg.inv(CAMERA).T
    return np.asarray(rays * depth[:, None])


def pose_of(matrix: FloatArray) -> DistortedPose:
    return DistortedPose(matrix=matrix, k1=0.0, reference_shape=FRAME, followup_shape=FRAME)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """Matches of two known cameras; where the plane has the source's, in target pixels."""

    camera: Turned
    matches: FeatureMatches
    is_true: BoolArray

    @classmethod
    def of(
        cls,
        camera: Turned,
        *,
        on_plane: float,
        noise_px: float = 0.0,
        outliers: float = 0.0,
        seed: int = 0,
    ) -> "Case":
        rng = np.random.default_rng(seed)
        points = points_of(rng, 400, on_plane)
        target, source = pinhole(points), camera.seen(points)
        wrong = rng.random(len(points)) < outliers
        source[wrong] += rng.uniform(-30, 30, (np.count_nonzero(wrong), 2))
        source, target = (one + rng.normal(0, noise_px, one.shape) for one in (source, target))
        return cls(camera=camera, matches=FeatureMatches(target, source), is_true=~wrong)

    def found(self) -> EpipolarGeometry | None:
        return epipolar_geometry(self.matches, pose_of(self.camera.plane))

    def parallax_px(self) -> FloatArray:
        """Of the true plane and epipole, towards the epipole, or the way the geometry counts."""
        own = self.matches.followup_px
        away = moved(np.linalg.inv(self.camera.plane), self.matches.reference_px) - own
        return np.asarray(np.sum(away * towards(self.camera.epipole, own), axis=1))


def moved(matrix: NDArray[np.floating[Any]], points: FloatArray) -> FloatArray:
    found = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(found[:, :2] / found[:, 2:])


def towards(epipole: FloatArray, points: FloatArray) -> FloatArray:
    """Unit vectors (n, 2) along the lines; one of the two ways for all points."""
    along = epipole[:2] - epipole[2] * points
    return np.asarray(along / np.linalg.norm(along, axis=1, keepdims=True))


def line_error_px(found: EpipolarGeometry, true: FloatArray) -> float:
    """How far the lines through 400 places are from the true ones, a parallax of 20 px away."""
    y, x = np.meshgrid(np.linspace(0, 299, 20), np.linspace(0, 399, 20), indexing="ij")
    to = towards(true, np.column_stack([x.ravel(), y.ravel()]))
    along_x, along_y = (one.ravel() for one in found.directions(x, y))
    return 20 * float(np.median(np.abs(to[:, 0] * along_y - to[:, 1] * along_x)))


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("on_plane", [0.0, 0.5, 0.9])
def test_the_epipole_is_the_other_cameras_centre(name: str, on_plane: float) -> None:
    case = Case.of(CAMERAS[name], on_plane=on_plane)
    found = known(case.found())
    assert found.near.all()
    assert np.linalg.norm(found.epipole) == pytest.approx(1.0)
    # Matches are exact, and OpenCV's fits are good to .01 px of the lines.
    assert line_error_px(found, case.camera.epipole) < 0.02


@pytest.mark.parametrize("name", CAMERAS)
def test_a_dominant_plane_is_the_plane_and_parallax_is_beside_it(name: str) -> None:
    case = Case.of(CAMERAS[name], on_plane=0.9)
    found = known(case.found())
    y, x = np.meshgrid(np.linspace(0, 299, 9), np.linspace(0, 399, 9), indexing="ij")
    at = np.column_stack([x.ravel(), y.ravel()])
    np.testing.assert_allclose(
        moved(found.pose.matrix, at), moved(case.camera.plane, at), atol=0.02
    )
    true = case.parallax_px()
    # Lines have no ends: which way counts is the same for all.
    sign = np.sign(np.sum(true * found.parallax_px))
    np.testing.assert_allclose(sign * found.parallax_px, true, atol=0.05)


@pytest.mark.parametrize("name", CAMERAS)
def test_any_plane_found_leaves_displacements_along_the_lines_alone(name: str) -> None:
    case = Case.of(CAMERAS[name], on_plane=0.0)
    found = known(case.found())
    own = case.matches.followup_px
    away = moved(np.linalg.inv(found.pose.matrix), case.matches.reference_px) - own
    x, y = own.T
    along = np.stack(found.directions(x, y), axis=1)
    np.testing.assert_allclose(
        away, found.parallax_px[:, None] * along, atol=0.05, err_msg="across the lines"
    )
    # The plane is within what the points fill: none stands out by more than all of it.
    assert np.ptp(found.parallax_px) < 1.5 * np.ptp(case.parallax_px())


@pytest.mark.slow
@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(("on_plane", "outliers"), [(0.3, 0.4), (0.85, 0.2)])
def test_wrong_matches_do_not_move_the_geometry(
    name: str, on_plane: float, outliers: float
) -> None:
    errors = []
    for seed in range(5):
        case = Case.of(CAMERAS[name], on_plane=on_plane, noise_px=0.2, outliers=outliers, seed=seed)
        found = known(case.found())
        # .2 px along both axes of both: .28 px across the line, of which 1 px is 3.5 deviations.
        assert found.near[case.is_true].mean() > 0.98
        # Wrong by up to 30 px either way: 1 of 30 lies within a pixel of a line by chance, of those
        # near the plane's place and of those that the geometry was chosen for more.
        assert found.near[~case.is_true].mean() < 0.15
        errors.append(line_error_px(found, case.camera.epipole))
    # 40 matches or more that are displaced by 5 px (rms) fix directions to .28 / 5 / 40^.5, which
    # is .18 px at a parallax of 20 px. Least squares of the true matches alone, by a general
    # optimiser, leave medians of .05 to .15 px.
    assert np.median(errors) < 0.5


@pytest.mark.parametrize("noise_px", [0.0, 0.3])
@pytest.mark.parametrize("name", CAMERAS)
def test_points_on_a_plane_tell_of_no_depth(name: str, noise_px: float) -> None:
    assert Case.of(CAMERAS[name], on_plane=1.0, noise_px=noise_px).found() is None


@pytest.mark.parametrize("outliers", [0.2, 0.4])
def test_points_on_a_plane_with_wrong_matches_tell_of_no_depth(outliers: float) -> None:
    case = Case.of(CAMERAS["aside"], on_plane=1.0, noise_px=0.2, outliers=outliers)
    assert case.found() is None


def on_one_thing(shift_px: tuple[float, float], half_px: float) -> FeatureMatches:
    """A plane of which what is around one place was moved between the photographs."""
    rng = np.random.default_rng(3)
    own = rng.uniform((0, 0), (399, 299), (500, 2))
    other = own + rng.normal(0, 0.2, own.shape)
    thing = np.abs(own - (120.0, 180.0)).max(axis=1) < half_px
    assert np.count_nonzero(thing) > 15
    other[thing] += shift_px
    return FeatureMatches(own, other)


@pytest.mark.parametrize("shift_px", [(9.0, 0.0), (0.0, -12.0), (5.0, 5.0)])
def test_a_thing_that_moved_is_no_depth(shift_px: tuple[float, float]) -> None:
    assert epipolar_geometry(on_one_thing(shift_px, 40.0), pose_of(np.eye(3))) is None


def test_matches_that_have_nothing_in_common_tell_of_no_depth() -> None:
    rng = np.random.default_rng(5)
    own, other = (rng.uniform((0, 0), (399, 299), (300, 2)) for _ in range(2))
    near = own + rng.uniform(-30, 30, own.shape)
    for there in (other, near):
        assert epipolar_geometry(FeatureMatches(own, there), pose_of(np.eye(3))) is None


@pytest.mark.parametrize("name", ["aside_and_turned", "forward"])
def test_directions_are_those_to_the_true_epipole_through_a_distorting_lens(name: str) -> None:
    k1, corner = -0.05, np.hypot(199.5, 149.5)

    def distorted(points: FloatArray) -> FloatArray:
        middle = np.array([199.5, 149.5])
        square = np.sum((points - middle) ** 2, axis=1, keepdims=True) / corner**2
        return np.asarray(middle + (points - middle) * (1 + k1 * square))

    case = Case.of(CAMERAS[name], on_plane=0.5)
    own, other = case.matches.followup_px, case.matches.reference_px
    inside = (np.abs(other - (199.5, 149.5)) < (230, 180)).all(axis=1)
    matches = FeatureMatches(distorted(own[inside]), distorted(other[inside]))
    pose = pose_of(case.camera.plane).with_(case.camera.plane, k1)
    found = known(epipolar_geometry(matches, pose))
    assert found.pose.k1 == k1
    x, y = matches.followup_px.T
    # Where a point lies a small step along its ideal line, seen through the lens.
    along = towards(case.camera.epipole, own[inside])
    step = distorted(own[inside] + 0.01 * along) - distorted(own[inside] - 0.01 * along)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    to_x, to_y = found.directions(x, y)
    across = step[:, 0] * to_y - step[:, 1] * to_x
    # OpenCV's fit of the lines to .02 px in 20, and half a pixel for the lens's slopes.
    assert np.median(np.abs(across)) < 2e-3


@pytest.mark.parametrize("name", BESIDE)
def test_an_epipole_that_passes_infinity_turns_no_parallax_round(name: str) -> None:
    """Its third coordinate changes its sign there; lines hardly turn, nor do displacements."""
    case = Case.of(CAMERAS[name], on_plane=0.5)
    found = known(case.found())
    x, y = case.matches.followup_px.T
    before = found.parallax_px * np.stack(found.directions(x, y))
    for third in (-1e-5, 1e-5):
        epipole = np.array([*found.epipole[:2], third])
        by = Correction(change=np.eye(3), epipole=epipole / np.linalg.norm(epipole))
        turned = found.corrected(by)
        after = turned.parallax_px * np.stack(turned.directions(x, y))
        # Lines turn by less than .6: cameras beside the target's have their epipoles some 1500 px
        # away at least, so that a side of 400 px is no more than that of them.
        lengths = np.abs(found.parallax_px)
        assert np.all(np.hypot(*(after - before)) <= 0.6 * lengths + 1e-9)


def test_a_sample_that_opencv_cannot_solve_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def raising(*_: object) -> object:
        raise cv2.error("!model.empty() in function 'setModelParameters'")

    monkeypatch.setattr(cv2, "findFundamentalMat", raising)
    rng = np.random.default_rng(129)
    own = rng.uniform(0.0, 60.0, (8, 2))
    there = FeatureMatches(own, own + rng.normal(0.0, 1.0, own.shape))
    assert epipolar_geometry(there, pose_of(np.eye(3))) is None
    # The plane and two matches beside it tell the geometry as well.
    case = Case.of(CAMERAS["aside_and_turned"], on_plane=0.5)
    assert line_error_px(known(case.found()), case.camera.epipole) < 0.02
