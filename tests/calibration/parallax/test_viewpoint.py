"""Where the cameras stood, and heights above a plane: worked out forwards, and found again."""

from dataclasses import dataclass
from math import atan2, degrees

import cv2
import numpy as np
import pytest

from calibration.parallax import FrameCamera, SeenParallax, Viewpoint, likely_viewpoint
from simulation.arrays import FloatArray
from tests.calibration.known import known

SHAPE = (300, 400)
CAMERA = FrameCamera(focal_length_px=520.0, principal_px=(199.5, 149.5))
CORNERS = np.array([0.0, 399, 0, 399]), np.array([0.0, 0, 299, 299])
ASIDE, FARTHER, NEARER = (0.2, -0.1, 0.02), (-0.1, 0.15, 0.3), (0.12, 0.05, -0.4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setup:
    """A plane at distance 1 of a follow-up's camera, and a reference's that stood at ``centre``."""

    centre: FloatArray
    normal: FloatArray
    rotation: FloatArray

    @classmethod
    def of(cls, centre: tuple[float, float, float]) -> "Setup":
        normal = np.array([0.15, -0.2, 1.0])
        rotation, _ = cv2.Rodrigues(np.array([0.05, -0.12, 0.3]))
        return cls(
            centre=np.array(centre),
            normal=normal / np.linalg.norm(normal),
            rotation=np.asarray(rotation, dtype=np.float64),
        )

    @property
    def matrix(self) -> FloatArray:
        k = CAMERA.matrix
        made = self.rotation @ (np.eye(3) - np.outer(self.centre, self.normal))
        found = k @ made @ np.linalg.inv(k)
        return np.asarray(found / found[2, 2])

    @property
    def epipole(self) -> FloatArray:
        seen = CAMERA.matrix @ self.centre
        seen = seen / np.linalg.norm(seen)
        return np.asarray(seen if seen[2] >= 0 else -seen)

    def seen(self, heights: FloatArray, error_px: float = 0.0) -> SeenParallax:
        """Points above the plane at a grid of pixels, projected and brought back by the plane."""
        x, y = (at.ravel() for at in np.meshgrid(np.linspace(10, 390, 9), np.linspace(10, 290, 7)))
        rays = CAMERA.rays(x, y)
        points = rays * (1 - heights) / (self.normal @ rays)
        there = CAMERA.matrix @ self.rotation @ (points - self.centre[:, None])
        back = np.linalg.solve(self.matrix, there)
        away = back[:2] / back[2] - np.stack([x, y])
        epipole = self.epipole
        towards = epipole[:2, None] - epipole[2] * np.stack([x, y])
        towards = towards / np.hypot(*towards)
        along = np.sum(away * towards, axis=0)
        # Nothing moves across.
        np.testing.assert_allclose(away, along * towards, atol=1e-8)
        return SeenParallax(
            epipole=epipole,
            x_px=x,
            y_px=y,
            parallax_px=along,
            error_px=np.full(len(x), error_px),
        )


HEIGHTS = np.linspace(-0.1, 0.25, 63)


@pytest.mark.parametrize("centre", [ASIDE, FARTHER, NEARER])
def test_a_plane_and_an_epipole_say_where_the_reference_was_taken(
    centre: tuple[float, float, float],
) -> None:
    setup = Setup.of(centre)
    for epipole in (setup.epipole, -setup.epipole):
        found = known(Viewpoint.of(setup.matrix, epipole, CAMERA))
        np.testing.assert_allclose(found.centre, centre, atol=1e-9)
        np.testing.assert_allclose(found.normal, setup.normal, atol=1e-9)
        assert found.normal_err < 1e-7
        assert found.distance_ratio == pytest.approx(1 - setup.normal @ setup.centre)
        assert found.sees_plane_at(*CORNERS)


@pytest.mark.parametrize("centre", [ASIDE, FARTHER, NEARER])
def test_heights_are_those_of_the_points_and_nearer_is_positive(
    centre: tuple[float, float, float],
) -> None:
    setup = Setup.of(centre)
    seen = setup.seen(HEIGHTS)
    viewpoint = known(Viewpoint.of(setup.matrix, setup.epipole, CAMERA))
    np.testing.assert_allclose(viewpoint.heights(seen).height, HEIGHTS, atol=1e-9)
    signs = np.sign(seen.parallax_px) * viewpoint.nearer_sign(setup.epipole)
    np.testing.assert_array_equal(signs, np.sign(HEIGHTS))


def test_the_error_of_a_height_is_that_of_its_parallax() -> None:
    setup = Setup.of(FARTHER)
    viewpoint = known(Viewpoint.of(setup.matrix, setup.epipole, CAMERA))
    step_px = 1e-4
    seen = setup.seen(HEIGHTS, step_px)
    more = SeenParallax(
        epipole=seen.epipole,
        x_px=seen.x_px,
        y_px=seen.y_px,
        parallax_px=seen.parallax_px + step_px,
        error_px=seen.error_px,
    )
    moved = np.abs(viewpoint.heights(more).height - HEIGHTS)
    by_plane = viewpoint.heights(setup.seen(HEIGHTS)).error
    expected = np.hypot(moved, by_plane)
    np.testing.assert_allclose(viewpoint.heights(seen).error, expected, rtol=1e-3)


def test_a_plane_is_known_the_better_the_more_its_tilt_is_seen() -> None:
    wide, narrow = (
        known(Viewpoint.of(Setup.of(centre).matrix, Setup.of(centre).epipole, CAMERA))
        for centre in (ASIDE, (0.02, -0.01, 0.002))
    )
    # .05 px of what a baseline of .225 displaces 199.5 px from the middle by, in proportion to it.
    assert wide.tilt_err == pytest.approx(0.05 * 520 / 199.5**2 / np.linalg.norm(ASIDE), rel=1e-3)
    assert narrow.tilt_err == pytest.approx(10 * wide.tilt_err, rel=1e-3)


def test_an_epipole_that_contradicts_the_plane_widens_the_error_away_from_the_middle() -> None:
    setup = Setup.of(ASIDE)
    aside = setup.epipole + np.array([0.0, 0.1, 0.0])
    viewpoint = known(Viewpoint.of(setup.matrix, aside, CAMERA))
    assert viewpoint.tilt_err > viewpoint.normal_err > 0.01
    flat = SeenParallax(
        epipole=aside,
        x_px=np.array([199.5, 199.5 + 52.0]),
        y_px=np.array([149.5, 149.5]),
        parallax_px=np.zeros(2),
        error_px=np.zeros(2),
    )
    # A plane tilted by an angle is off by it times the distance from the axis: 52 of 520 px.
    np.testing.assert_allclose(
        viewpoint.heights(flat).error, [0.0, 0.1 * viewpoint.tilt_err], atol=1e-12
    )


def test_a_camera_that_only_turned_has_no_viewpoint() -> None:
    setup = Setup.of((0.0, 0.0, 0.0))
    assert Viewpoint.of(setup.matrix, np.array([1.0, 0.0, 0.0]), CAMERA) is None


@pytest.mark.parametrize("centre", [ASIDE, FARTHER, NEARER])
def test_the_side_is_known_without_the_lens(centre: tuple[float, float, float]) -> None:
    setup = Setup.of(centre)
    found = known(likely_viewpoint(setup.matrix, setup.epipole, SHAPE))
    x, y, _ = found.centre.tolist()
    turned = degrees(atan2(y, x) - atan2(centre[1], centre[0]))
    # The lens that fits best of those tried is not quite the true one.
    assert abs((turned + 180) % 360 - 180) < 2.0
    true = known(Viewpoint.of(setup.matrix, setup.epipole, CAMERA))
    assert found.nearer_sign(setup.epipole) == true.nearer_sign(setup.epipole)


def test_what_a_turned_camera_also_shows_decides_no_side() -> None:
    # No lens makes the epipole agree with a plane that is stretched across it.
    stretched = np.diag([1.0, 1.5, 1.0])
    assert likely_viewpoint(stretched, np.array([1.0, 0.0, 0.0]), SHAPE) is None


def test_a_mirror_image_decides_no_side() -> None:
    setup = Setup.of(ASIDE)
    flip = np.array([[-1.0, 0.0, 399.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert likely_viewpoint(setup.matrix, setup.epipole, SHAPE) is not None
    assert likely_viewpoint(flip @ setup.matrix, setup.epipole, SHAPE) is None
