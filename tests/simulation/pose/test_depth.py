"""Follow-ups of scenes with depth: planes as limits, closed forms of a step, an own renderer."""

from math import radians

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from benchmarks.studies.depth_simulation import depth_errors
from benchmarks.truth.depth import DepthKind
from simulation import (
    GaussianPsf,
    PoseOptions,
    PsfField,
    SamplingGrid,
    SceneDepth,
    simulate_pose_of_image,
)
from simulation.arrays import BoolArray, FloatArray
from simulation.choices import POSE_MODELS, PoseModel
from simulation.pose import DepthRendering, DepthView, pose_noise_gain
from simulation.psf import Psf
from tests.simulation.poses import PHOTOGRAPH, PSF, TILTED_PSF, constant_field

SHAPE = PHOTOGRAPH.shape
SIZE = SHAPE[1], SHAPE[0]
FOCAL_PX = 900.0
"""Of the camera of all tests but those of the own renderer."""


def lens(shape: tuple[int, int] = (SHAPE[0], SHAPE[1])) -> FloatArray:
    return np.array(
        [
            [FOCAL_PX, 0.0, (shape[1] - 1) / 2],
            [0.0, FOCAL_PX, (shape[0] - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )


def rotation(x_deg: float, y_deg: float, z_deg: float) -> FloatArray:
    x, y, z = (radians(one) for one in (x_deg, y_deg, z_deg))
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x, dtype=np.float64)


def plane_depth(plane: FloatArray) -> FloatArray:
    """Depth map of the plane whose inverse depth along a ray q is ``plane . q``."""
    y, x = np.meshgrid(*(np.arange(float(n)) for n in SHAPE), indexing="ij")
    rays = np.linalg.inv(lens()) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    return np.asarray(1 / (plane @ rays).reshape(SHAPE), dtype=np.float64)


def homography_of(turned: FloatArray, pupil: FloatArray, plane: FloatArray) -> FloatArray:
    """Follow-up to reference pixels, of a camera at ``R p + t`` that sees a plane."""
    onward = lens() @ (turned + np.outer(pupil, plane)) @ np.linalg.inv(lens())
    back = np.linalg.inv(onward)
    return np.asarray(back / back[2, 2])


TILTED_PLANE = np.array([0.0004, -0.0003, 1 / 700])
TURNED, PUPIL = rotation(4.0, -6.0, 8.0), np.array([30.0, -22.0, 160.0])


def rendered_flat(
    psf: Psf | PsfField, model: PoseModel = "lmmse", k1: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """The same tilted plane, by its homography and as a depth map."""
    matrix = homography_of(TURNED, PUPIL, TILTED_PLANE)
    options = PoseOptions(model=model, distortion_k1=k1)
    flat = simulate_pose_of_image(PHOTOGRAPH, matrix, SIZE, psf, options)
    scene = SceneDepth(depth=plane_depth(TILTED_PLANE), focal_length_px=FOCAL_PX)
    view = DepthView.of_homography(scene, matrix, SIZE, k1)
    deep = DepthRendering.of(scene, view, psf).photograph(PHOTOGRAPH, PoseOptions(model=model))
    assert deep.hidden is not None
    assert not deep.hidden.any()
    both = ~(flat.outside | deep.outside)
    # Pixels whose places lie within rounding of the reference's border.
    assert np.count_nonzero(flat.outside != deep.outside) <= 4
    return np.asarray(flat.image[both], float), np.asarray(deep.image[both], float)


# A plane is a scene with depth of which all is known: the homography's own rendering, which is
# measured elsewhere, is the truth. What is left is the polynomials' fit of the kernels.


@pytest.mark.parametrize("model", POSE_MODELS)
@pytest.mark.parametrize("psf", [PSF, TILTED_PSF])
def test_a_plane_looks_as_its_homography_makes_it(psf: GaussianPsf, model: PoseModel) -> None:
    flat, deep = rendered_flat(psf, model)
    assert np.std(deep - flat) < 1e-3 * np.std(flat)


def test_a_psf_that_varies_over_the_frame_does_so_over_depth() -> None:
    field = PsfField(
        width_px=SIZE[0],
        height_px=SIZE[1],
        coefficients_px2=np.array([[0.5, 0.05, -0.04], [0.0, 0.03, 0.02], [0.6, -0.05, 0.05]]),
    )
    flat, deep = rendered_flat(field)
    constant = rendered_flat(constant_field(*SIZE, PSF))[1]
    assert np.std(deep - flat) < 2e-3 * np.std(flat)
    assert np.std(constant - flat) > 5e-3 * np.std(flat)


def test_a_lens_distorts_a_scene_with_depth_as_a_flat_one() -> None:
    # Depth is given at the pixels as photographed, whose ideal rays the lens bends.
    k1 = -0.04
    frontal = np.array([0.0, 0.0, 1 / 700])
    matrix = homography_of(TURNED, PUPIL, frontal)
    flat = simulate_pose_of_image(
        PHOTOGRAPH, matrix, SIZE, PSF, PoseOptions(model="lmmse", distortion_k1=k1)
    )
    scene = SceneDepth(depth=np.full(SHAPE, 700.0), focal_length_px=FOCAL_PX)
    view = DepthView.of_homography(scene, matrix, SIZE, k1)
    deep = DepthRendering.of(scene, view, PSF).photograph(PHOTOGRAPH)
    both = ~(flat.outside | deep.outside)
    assert np.std((deep.image - flat.image)[both]) < 1e-3 * np.std(flat.image[both])


@pytest.mark.parametrize("zoom", [1.0, 1.37, 2.2])
def test_a_level_plane_further_away_is_the_zoom_out(zoom: float) -> None:
    grid = SamplingGrid.centred((SHAPE[0], SHAPE[1]), zoom)
    flat = simulate_pose_of_image(PHOTOGRAPH, grid.matrix, (grid.cols, grid.rows), PSF)
    scene = SceneDepth(depth=np.full(SHAPE, 3.5))
    rendering = DepthRendering.of(scene, DepthView.further_away(scene, zoom), PSF)
    deep = rendering.photograph(PHOTOGRAPH, PoseOptions(model="matched" if zoom == 1 else "lmmse"))
    assert deep.image.shape == flat.image.shape
    assert np.std(deep.image - flat.image) < 1e-3 * np.std(flat.image)


# A step, in closed form: with the camera moved by b across a plane at the depth D, a thing at the
# depth d is displaced by f b (1 / d - 1 / D) px beside the plane.


def step_scene(depth: float, near: float) -> tuple[SceneDepth, BoolArray]:
    """A plane at a depth, and a rectangle before it; and where that is in the reference."""
    is_near = np.zeros(SHAPE, dtype=np.bool_)
    rows, cols = SHAPE
    is_near[rows // 4 : 3 * rows // 4, cols // 3 : 2 * cols // 3] = True
    made = np.where(is_near, near, depth)
    return SceneDepth(depth=made, focal_length_px=FOCAL_PX), is_near


def moved_aside(scene: SceneDepth, depth: float, aside: float) -> DepthView:
    pupil = np.array([-aside, 0.0, 0.0])
    matrix = homography_of(np.eye(3), pupil, np.array([0.0, 0.0, 1 / depth]))
    return DepthView.of_homography(scene, matrix, SIZE)


@pytest.mark.parametrize("aside", [12.0, -20.0])
def test_a_step_uncovers_and_covers_as_wide_a_strip_as_its_parallax(aside: float) -> None:
    depth, near = 700.0, 600.0
    scene, is_near = step_scene(depth, near)
    rendering = DepthRendering.of(scene, moved_aside(scene, depth, aside), PSF)
    seen = rendering.seen
    parallax_px = FOCAL_PX * abs(aside) * (1 / near - 1 / depth)
    rows, cols = SHAPE
    through = seen.hidden[rows // 4 + 3 : 3 * rows // 4 - 3]
    # All rows through the rectangle alike, the strip as wide as the parallax to a pixel.
    assert np.all(through == through[0])
    assert np.count_nonzero(through[0]) == pytest.approx(parallax_px, abs=1.0)
    assert not seen.hidden[: rows // 4 - 3].any()
    # The rectangle is where its depth puts it.
    y, x = seen.places_px
    on_it = np.zeros(SHAPE, dtype=np.bool_)
    known = ~np.isnan(x)
    on_it[known] = is_near[np.rint(y[known]).astype(int), np.rint(x[known]).astype(int)]
    moved_px = -FOCAL_PX * aside / near
    first = np.flatnonzero(on_it[rows // 2])[0]
    assert first == pytest.approx(cols // 3 + moved_px, abs=1.0)
    middle_x = x[rows // 2, int(cols / 2 + moved_px)]
    assert middle_x == pytest.approx(int(cols / 2 + moved_px) - moved_px, abs=1e-4)


def test_a_nearer_thing_grows_as_its_own_distances_say() -> None:
    # At twice the distance of the plane, a thing at half the plane's depth is three times as far.
    depth = 700.0
    scene, _ = step_scene(depth, depth / 2)
    rendering = DepthRendering.of(scene, DepthView.further_away(scene, 2.0), PSF)
    y, x = rendering.seen.places_px
    middle = x.shape[0] // 2, x.shape[1] // 2
    assert x[middle] - x[middle[0], middle[1] - 1] == pytest.approx(3.0, abs=1e-6)
    assert y[middle] - y[middle[0] - 1, middle[1]] == pytest.approx(3.0, abs=1e-6)
    assert x[2, 3] - x[2, 2] == pytest.approx(2.0, abs=1e-6)


def test_what_has_no_depth_is_hidden_and_nothing_else() -> None:
    scene, _ = step_scene(700.0, 700.0)
    depth = scene.depth.copy()
    depth[20:26, 30:40] = np.nan
    holed = SceneDepth(depth=depth)
    rendering = DepthRendering.of(holed, DepthView.further_away(holed, 1.0), PSF)
    assert np.array_equal(rendering.seen.hidden, np.isnan(depth))


def test_what_has_no_depth_is_hidden_through_a_psf_that_varies_too() -> None:
    depth = np.full(SHAPE, 700.0)
    depth[20:46, 30:60] = np.nan
    scene = SceneDepth(depth=depth, focal_length_px=FOCAL_PX)
    matrix = homography_of(np.eye(3), np.array([0.0, 0.0, 70.0]), np.array([0.0, 0.0, 1 / 700]))
    view = DepthView.of_homography(scene, matrix, SIZE)
    found = DepthRendering.of(scene, view, constant_field(*SIZE, PSF)).photograph(PHOTOGRAPH)
    plain = DepthRendering.of(scene, view, PSF).photograph(PHOTOGRAPH)
    assert found.hidden is not None
    assert np.count_nonzero(found.hidden) > 400
    assert np.std(found.image - plain.image) < 1e-3 * np.std(PHOTOGRAPH)


def test_the_plane_is_that_of_most_of_the_scene() -> None:
    rng = np.random.default_rng(4)
    depth = plane_depth(TILTED_PLANE)
    # Two fifths of it stand before the plane, at many distances.
    cells = rng.uniform(size=(SHAPE[0] // 10 + 1, SHAPE[1] // 10 + 1)) < 0.4
    heights = np.where(cells, rng.uniform(0.7, 0.97, cells.shape), 1.0)
    depth *= np.repeat(np.repeat(heights, 10, 0), 10, 1)[: SHAPE[0], : SHAPE[1]]
    found = SceneDepth(depth=depth, focal_length_px=FOCAL_PX).plane
    assert found == pytest.approx(TILTED_PLANE, rel=1e-6)


def test_a_stated_plane_is_taken() -> None:
    scene = SceneDepth(depth=np.full(SHAPE, 3.0), focal_length_px=FOCAL_PX, plane_depth=4.0)
    assert scene.plane.tolist() == [0.0, 0.0, 0.25]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "parallax_px", "tilt_deg", "zoom"),
    [("hills", 20.0, 8.0, 1.3), ("plates", 30.0, 12.0, 1.1), ("both", 20.0, 10.0, 1.5)],
)
def test_it_looks_as_an_own_renderer_makes_it(
    kind: DepthKind, parallax_px: float, tilt_deg: float, zoom: float
) -> None:
    # Rays followed to the surface that they meet first: no code is shared. What the flat ground
    # alone differs by, at the same pose, is what sampling costs.
    found = depth_errors(kind, parallax_px, tilt_deg, zoom)
    assert found.apart < 1.5 * (found.flat + 0.01)
    assert found.everywhere < 0.5 * found.plane
    assert found.wrong_px == 0
    assert kind == "hills" or found.hidden_px > 500


@settings(max_examples=12)
@given(
    seed=st.integers(0, 10**6),
    level=st.floats(1.0, 900.0),
    zoom=st.floats(1.0, 2.5),
)
def test_an_even_scene_stays_even_whatever_its_depth(seed: int, level: float, zoom: float) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.uniform(0.8, 1.2, (7, 9))
    depth = np.repeat(np.repeat(cells, 10, 0), 10, 1) * 500
    scene = SceneDepth(depth=depth)
    rendering = DepthRendering.of(scene, DepthView.further_away(scene, zoom), PSF)
    found = rendering.photograph(np.full(depth.shape, level))
    seen = ~(rendering.seen.hidden | rendering.seen.outside)
    assert found.image[seen] == pytest.approx(level, rel=1e-9)
    assert np.all(found.image[~seen] == 0)


def test_the_noise_passed_is_that_of_many_noisy_references() -> None:
    scene, _ = step_scene(700.0, 560.0)
    view = moved_aside(scene, 700.0, 15.0)
    rendering = DepthRendering.of(scene, view, PSF)
    gain = rendering.noise_gain()
    rng = np.random.default_rng(1)
    noisy = [rendering.photograph(rng.normal(0.0, 1.0, SHAPE)).image for _ in range(40)]
    measured = np.var(np.stack(noisy), axis=0, ddof=1)
    seen = ~(rendering.seen.hidden | rendering.seen.outside)
    assert np.mean(measured[seen]) == pytest.approx(np.mean(gain[seen]), rel=0.02)
    assert np.all(gain[~seen] == 0)


def test_the_noise_gain_over_a_plane_is_that_of_its_homography() -> None:
    matrix = homography_of(TURNED, PUPIL, TILTED_PLANE)
    scene = SceneDepth(depth=plane_depth(TILTED_PLANE), focal_length_px=FOCAL_PX)
    rendering = DepthRendering.of(scene, DepthView.of_homography(scene, matrix, SIZE), PSF)
    seen = ~(rendering.seen.hidden | rendering.seen.outside)
    flat = pose_noise_gain(matrix, (SHAPE[0], SHAPE[1]), SIZE, PSF)
    assert rendering.noise_gain()[seen] == pytest.approx(flat[seen], abs=2e-3)


def test_threads_change_nothing() -> None:
    scene, _ = step_scene(700.0, 560.0)
    rendering = DepthRendering.of(scene, moved_aside(scene, 700.0, 15.0), PSF)
    one, two = (
        rendering.photograph(PHOTOGRAPH, PoseOptions(threads=threads)).image for threads in (1, 2)
    )
    assert np.array_equal(one, two)


def test_a_focal_length_that_the_homography_contradicts_is_refused() -> None:
    matrix = homography_of(rotation(25.0, 0.0, 0.0), np.array([0.0, 300.0, 60.0]), TILTED_PLANE)
    depth = plane_depth(TILTED_PLANE)
    right = SceneDepth(depth=depth, focal_length_px=FOCAL_PX)
    assert DepthView.of_homography(right, matrix, SIZE).follow_up == SHAPE
    with pytest.raises(ValueError, match="focal length of 1350 px"):
        DepthView.of_homography(
            SceneDepth(depth=depth, focal_length_px=1.5 * FOCAL_PX), matrix, SIZE
        )


def test_an_image_of_another_frame_is_refused() -> None:
    scene = SceneDepth(depth=np.full((40, 50), 3.0))
    rendering = DepthRendering.of(scene, DepthView.further_away(scene, 1.2), PSF)
    with pytest.raises(ValueError, match="depth map has 50 x 40 px"):
        rendering.photograph(PHOTOGRAPH)


def test_a_follow_up_that_sees_nothing_of_the_reference_is_refused() -> None:
    scene = SceneDepth(depth=np.full(SHAPE, 700.0), focal_length_px=FOCAL_PX)
    with pytest.raises(ValueError, match="shows nothing"):
        DepthRendering.of(scene, moved_aside(scene, 700.0, 900.0), PSF)
