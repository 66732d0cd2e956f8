"""The judge's scenes beside closed forms and GalSim's rendering of the same rectangles."""

from math import pi

import numpy as np
import pytest

from benchmarks.truth.lens_scenes import (
    Pose,
    Scene,
    cover,
    pose_photograph,
    rectangle_corners,
    slanted_rectangles,
)
from benchmarks.truth.lenses import edge_response, elsewhere, f_number, further, gaussian
from simulation.arrays import FloatArray

SIDE_PX, SAMPLES = 64, 8
RECTANGLES = (
    ((20.3, 22.1), [17.0, 9.5], 0.3, 100.0),
    ((45.2, 40.7), [21.0, 12.0], 1.9, 230.0),
)
"""Centre, sides, turn and level; apart from one another."""


def two_rectangles() -> Scene:
    cells = np.zeros((SIDE_PX * SAMPLES, SIDE_PX * SAMPLES))
    for centre, sides, turn, level in RECTANGLES:
        cover(cells, rectangle_corners(np.array(centre), sides, turn), SAMPLES, level)
    return Scene.of_cells(cells, SAMPLES)


def galsim_photograph(cut_off_cy_per_px: float) -> FloatArray:
    galsim = pytest.importorskip("galsim", reason="the independent renderer is not installed")
    optics = galsim.Airy(lam_over_diam=1 / cut_off_cy_per_px)
    total = None
    middle = (SIDE_PX - 1) / 2
    for centre, sides, turn, level in RECTANGLES:
        box = galsim.Box(sides[0], sides[1], flux=level * sides[0] * sides[1])
        box = box.rotate(galsim.Angle(turn, galsim.radians))
        box = box.shift(centre[0] - middle, centre[1] - middle)
        total = box if total is None else total + box
    parameters = galsim.GSParams(folding_threshold=1e-3)
    seen = galsim.Convolve(total, optics, galsim.Pixel(1.0), gsparams=parameters)
    image = seen.drawImage(nx=SIDE_PX, ny=SIDE_PX, scale=1.0, method="no_pixel")
    return np.asarray(image.array, dtype=np.float64)


@pytest.mark.parametrize("number", [5.6, 11])
def test_rectangles_are_rendered_as_galsim_renders_them(number: float) -> None:
    camera = f_number(number)
    theirs = galsim_photograph(camera.cut_off_cy_per_px)
    difference = two_rectangles().reference(camera) - theirs
    # Ours is periodic: halos of the neighbouring copies are in it, near the border most.
    assert np.abs(difference[8:-8, 8:-8]).max() < 1e-3 * theirs.max()


def test_a_wide_edge_has_its_closed_form() -> None:
    """A stripe on the torus: half the period wide, its edges 16 px apart from the pixels judged."""
    camera = gaussian(0.5, has_pixel=True)
    cells = np.zeros((SIDE_PX * SAMPLES, SIDE_PX * SAMPLES))
    corners = np.array([[20.4, -32.0], [52.4, -32.0], [52.4, 32.0], [20.4, 32.0]])
    cover(cells, corners, SAMPLES, 200.0)
    image = Scene.of_cells(cells, SAMPLES).reference(camera)
    expected = 200 * edge_response(camera, 0.0, np.arange(6.0, 36.0) - 20.4)
    # Frequencies beyond 4 cy/px, which the cells fold back: 3e-4 of the step.
    assert np.abs(image[5, 6:36] - expected).max() < 0.06


def test_the_light_is_kept() -> None:
    scene = two_rectangles()
    total = sum(level * sides[0] * sides[1] for _, sides, _, level in RECTANGLES)
    # Lines 1/64 px apart, exact along them.
    assert scene.reference(f_number(2.8)).sum() == pytest.approx(total, rel=1e-6)
    assert scene.mean_dn * SIDE_PX**2 == pytest.approx(total, rel=1e-6)


def test_places_between_samples_are_those_of_the_series() -> None:
    scene, camera = slanted_rectangles(32, SAMPLES, seed=1), f_number(5.6)
    x, y = np.array([3.217, 20.9, 31.71]), np.array([7.77, 0.05, 15.333])
    series = scene.coefficients * further(camera, 2.0)(*scene.frequencies)
    fx, fy = scene.frequencies
    for index in range(len(x)):
        waves = series * np.exp(2j * pi * (fx * x[index] + fy * y[index]))
        expected = waves[:, 0].sum().real + 2 * waves[:, 1:-1].sum().real
        expected += waves[:, -1].sum().real
        found = scene.seen(further(camera, 2.0), x[index : index + 1], y[index : index + 1])
        assert found[0] == pytest.approx(expected, abs=1e-3)


def test_a_reference_is_the_scene_seen_at_its_pixels() -> None:
    scene, camera = slanted_rectangles(32, SAMPLES, seed=2), f_number(8)
    pixels = np.arange(32.0)
    seen = scene.seen(camera.otf, pixels[None, :], pixels[:, None])
    assert seen == pytest.approx(scene.reference(camera), abs=1e-8)


def test_scenes_hold_the_levels_asked_for_at_every_angle() -> None:
    scene = slanted_rectangles(96, SAMPLES, seed=0)
    levels = scene.reference(gaussian(0.7, has_pixel=False))
    assert levels.min() > 19
    assert levels.max() < 236
    assert 40 < levels.std() < 80
    slope_y, slope_x = (np.asarray(np.gradient(levels, axis=axis)) for axis in (0, 1))
    strong = np.hypot(slope_x, slope_y) > 20
    angles = np.arctan2(slope_y[strong], slope_x[strong]) % pi
    counts, _ = np.histogram(angles, bins=6, range=(0, pi))
    assert counts.min() > 0.04 * counts.sum()


def test_a_pose_without_tilt_is_a_zoom() -> None:
    scene, camera = slanted_rectangles(48, 6, seed=3), f_number(5.6)
    pose = Pose(zoom=2.0, reference_side=48, followup_side=24)
    places = 2.0 * (np.arange(24.0) - 11.5) + 23.5
    expected = scene.seen(further(camera, 2.0), places[None, :], places[:, None])
    # Nodes at the same derivative differ by the rounding of differences of 1e-3 px.
    assert pose_photograph(scene, camera, pose) == pytest.approx(expected, abs=1e-5)


def test_a_blend_over_nodes_equals_the_transfer_function_of_each_pixel() -> None:
    scene, camera = slanted_rectangles(96, 6, seed=3), f_number(5.6)
    pose = Pose(
        zoom=1.6,
        tilt_deg=30,
        bearing_deg=30,
        turn_deg=15,
        distortion_k1=0.01,
        reference_side=96,
        followup_side=48,
    )
    image = pose_photograph(scene, camera, pose)
    for row, col in ((3, 5), (24, 23), (40, 30)):
        at = np.array([float(col)]), np.array([float(row)])
        far = elsewhere(camera, pose.jacobian(*at)[0])
        # A hundredth of a DN: squared, 1e-4 beside bounds of 1e-2.
        exact = scene.seen(far, *pose.seen(*at))
        assert image[row, col] == pytest.approx(exact[0], abs=0.01)


def test_distortion_moves_corners_out_by_its_share() -> None:
    """Same pose, same frame: a distorting lens sees every point where it was."""
    pose = Pose(zoom=1.0, distortion_k1=0.03, reference_side=50, followup_side=50)
    x, y = pose.seen(*pose.pixels)
    assert x == pytest.approx(pose.pixels[0], abs=1e-9)
    assert y == pytest.approx(pose.pixels[1], abs=1e-9)
    further_off = Pose(zoom=2.0, distortion_k1=0.03, reference_side=50, followup_side=50)
    x, _ = further_off.seen(np.array([34.5]), np.array([24.5]))
    ideal = 10.0
    corner_square = 2 * 24.5**2
    for _ in range(20):
        ideal = 10.0 / (1 + 0.03 * ideal**2 / corner_square)
    seen = 2 * ideal * (1 + 0.03 * (2 * ideal) ** 2 / corner_square)
    assert x[0] == pytest.approx(24.5 + seen, abs=1e-9)
