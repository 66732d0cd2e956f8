"""Follow-ups from any pose: closed forms, a zoom and one PSF as limits, and their noise."""

from math import cos, radians

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.ndimage import map_coordinates

from simulation import (
    GaussianPsf,
    PoseOptions,
    PsfField,
    SamplingGrid,
    simulate_pose_of_image,
    zoom_operator,
    zoom_out_on_grid,
)
from simulation.arrays import FloatArray
from simulation.capture_noise import propagated_variance
from simulation.choices import POSE_MODELS, PoseModel
from simulation.pose._view_filter import pose_noise_gain
from tests.simulation.poses import (
    PHOTOGRAPH,
    PSF,
    TILTED_PSF,
    about_centre,
    blob,
    constant_field,
    tilted,
    turn,
)

IDENTITY = np.eye(3)

MATCHED = PoseOptions(model="matched")


@pytest.mark.parametrize("psf", [PSF, TILTED_PSF])
@pytest.mark.parametrize(
    "linear",
    [
        1.7 * turn(0.0),
        1.5 * turn(30.0),
        2.0 * turn(90.0),
        turn(20.0) @ np.diag([2.5, 1.3]) @ turn(-45.0),
        np.array([[1.6, 0.5], [0.0, 1.4]]),
    ],
)
def test_a_blob_becomes_the_blob_of_the_affine_closed_form(
    linear: FloatArray, psf: GaussianPsf
) -> None:
    size, reference = (90, 70), (160, 130)
    matrix = about_centre(linear, reference, size)
    sigma = psf.covariance_px2
    own = np.array([[6.0, 1.5], [1.5, 4.0]])
    place = np.array([70.3, 66.8])
    image = blob(reference[::-1], place, own + sigma)
    inverse = np.linalg.inv(linear)
    expected = blob(
        size[::-1],
        inverse @ (place - matrix[:2, 2]),
        inverse @ own @ inverse.T + sigma,
    ) / np.linalg.det(linear)
    simulated = simulate_pose_of_image(image, matrix, size, psf, MATCHED)
    # The kernel of the common blur is cut as zoom_out's is: up to 6.4e-4 of the peak where it is
    # correlated. Without a common blur it is 1e-4.
    assert simulated.image == pytest.approx(
        np.where(simulated.outside, 0, expected), abs=8e-4 * expected.max()
    )
    assert not simulated.nearer.any()


def test_the_exact_mapping_of_a_wide_blob_under_perspective() -> None:
    # A blob so wide that neither PSF matters to 1e-3: what is left is where its pixels go.
    size = (120, 80)
    matrix = tilted(130.0, size, 15.0, 1.2)
    image = blob((80, 120), np.array([52.0, 44.0]), np.diag([150.0, 150.0]))
    simulated = simulate_pose_of_image(image, matrix, size, PSF, MATCHED)
    x, y = np.meshgrid(np.arange(120), np.arange(80))
    places = matrix @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    x, y = (places[:2] / places[2]).reshape(2, *x.shape)
    expected = np.exp(-((x - 52) ** 2 + (y - 44) ** 2) / 300) / (300 * np.pi)
    inner = (np.abs(x - 59.5) < 50) & (np.abs(y - 39.5) < 30)
    assert simulated.image[inner] == pytest.approx(expected[inner], abs=0.015 * expected.max())


def on_grid(image: FloatArray, grid: SamplingGrid, psf: GaussianPsf) -> FloatArray:
    """Quintic spline through an image that is blurred in the Fourier domain, sampled by SciPy."""
    pad = 100
    mirrored = np.pad(image, pad, mode="symmetric")
    fy, fx = (np.fft.fftfreq(size) for size in mirrored.shape)
    fy, fx = fy[:, None], fx[None, :]
    (xx, xy), (_, yy) = psf.covariance_px2.tolist()
    xx, xy, yy = (
        xx * (grid.zoom_x**2 - 1),
        xy * (grid.zoom_x * grid.zoom_y - 1),
        yy * (grid.zoom_y**2 - 1),
    )
    blur = np.exp(-2 * np.pi**2 * (xx * fx * fx + 2 * xy * fx * fy + yy * fy * fy))
    spline = np.prod(
        np.broadcast_arrays(
            *((66 + 52 * np.cos(2 * np.pi * f) + 2 * np.cos(4 * np.pi * f)) / 120 for f in (fy, fx))
        ),
        axis=0,
    )
    coefficients = np.fft.ifft2(np.fft.fft2(mirrored) * blur / spline).real
    y, x = np.meshgrid(grid.rows_px, grid.cols_px, indexing="ij")
    places = [y + pad, x + pad]
    return np.asarray(map_coordinates(coefficients, places, order=5, prefilter=False))


@pytest.mark.slow
@pytest.mark.parametrize("psf", [PSF, TILTED_PSF, GaussianPsf(sigma_x_px=0.4, sigma_y_px=0.4)])
@pytest.mark.parametrize("zoom", [1.02, 1.1, 1.5, 2.0, 3.0])
def test_a_pure_zoom_is_the_spline_through_the_blurred_image(zoom: float, psf: GaussianPsf) -> None:
    grid = SamplingGrid.centred((200, 280), zoom)
    simulated = simulate_pose_of_image(
        PHOTOGRAPH, grid.matrix, (grid.cols, grid.rows), psf, MATCHED
    )
    expected = on_grid(PHOTOGRAPH, grid, psf)
    # What kernels of 24 px leave: up to 0.05 of 255 for the first PSF at zoom 1.1.
    assert simulated.image == pytest.approx(expected, abs=1e-3 * 255)
    assert float(np.sqrt(np.mean((simulated.image - expected) ** 2))) < 1.2e-4 * 255
    assert not simulated.outside.any()
    assert not simulated.nearer.any()


@pytest.mark.parametrize("zoom", [1.1, 2.0])
def test_a_pure_zoom_is_the_zoom_out_on_the_same_grid(zoom: float) -> None:
    grid = SamplingGrid.centred((200, 280), zoom)
    simulated = simulate_pose_of_image(
        PHOTOGRAPH, grid.matrix, (grid.cols, grid.rows), PSF, MATCHED
    )
    expected = zoom_out_on_grid(PHOTOGRAPH, grid, PSF, "matched")
    # The zoom-out's bands are short: it is up to 1.15 of 255 from the spline above at zoom 1.1,
    # and 0.29 at zoom 2; rms 0.09 and 0.03.
    assert simulated.image == pytest.approx(expected, abs=5e-3 * 255)
    assert float(np.sqrt(np.mean((simulated.image - expected) ** 2))) < 4e-4 * 255


def test_a_zoom_with_another_factor_per_axis_is_the_spline_on_that_grid() -> None:
    grid = SamplingGrid(
        zoom_y=1.4, zoom_x=1.8, origin_y_px=3.2, origin_x_px=0.4, rows=130, cols=150
    )
    simulated = simulate_pose_of_image(PHOTOGRAPH, grid.matrix, (150, 130), TILTED_PSF, MATCHED)
    assert simulated.image == pytest.approx(on_grid(PHOTOGRAPH, grid, TILTED_PSF), abs=6e-4 * 255)


def test_the_identity_gives_the_image_back() -> None:
    simulated = simulate_pose_of_image(PHOTOGRAPH, IDENTITY, (280, 200), PSF, MATCHED)
    # The spline's prefilter is cut at 13 px, where it is 2e-5.
    assert simulated.image == pytest.approx(PHOTOGRAPH, abs=1e-4 * 255)
    assert not simulated.nearer.any()
    assert not simulated.outside.any()


def test_a_whole_pixel_shift_and_a_quarter_turn_keep_the_pixels() -> None:
    # Follow-up (x, y) is reference (y + 10, 150 - x): x counts against the rows.
    matrix = np.array([[0.0, 1.0, 10.0], [-1.0, 0.0, 150.0], [0.0, 0.0, 1.0]])
    simulated = simulate_pose_of_image(
        PHOTOGRAPH, matrix, (120, 90), GaussianPsf(sigma_x_px=1, sigma_y_px=1), MATCHED
    )
    y, x = np.mgrid[:90, :120]
    assert simulated.image == pytest.approx(PHOTOGRAPH[150 - x, y + 10], abs=1e-4 * 255)


def test_a_pixel_off_centre_goes_where_the_homography_says() -> None:
    image = np.zeros((60, 100))
    image[20, 70] = 1.0
    matrix = np.diag([2.0, 1.5, 1.0])
    simulated = simulate_pose_of_image(image, matrix, (50, 40), PSF, MATCHED)
    assert simulated.image.argmax() == 13 * 50 + 35


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_a_constant_stays_a_constant(tilt_deg: float) -> None:
    simulated = simulate_pose_of_image(
        np.full((80, 120), 200.0),
        tilted(130.0, (120, 80), tilt_deg, 1.3),
        (120, 80),
        TILTED_PSF,
        MATCHED,
    )
    inside = ~simulated.outside
    # The table holds float32 weights.
    assert simulated.image[inside] == pytest.approx(200.0, rel=1e-6)
    assert (simulated.image[simulated.outside] == 0).all()


@pytest.mark.parametrize("psf", [PSF, TILTED_PSF])
def test_a_ramp_stays_a_ramp_away_from_the_border(psf: GaussianPsf) -> None:
    linear = turn(25.0) @ np.diag([1.6, 1.2])
    matrix = about_centre(linear, (150, 120), (40, 30))
    y, x = np.mgrid[:120, :150].astype(np.float64)
    simulated = simulate_pose_of_image(2 * x - 3 * y, matrix, (40, 30), psf, MATCHED)
    row, col = np.mgrid[:30, :40]
    place = np.tensordot(matrix[:2], np.stack([col, row, np.ones((30, 40))]), 1)
    # A kernel with its centre off by 1e-4 px would be seen.
    assert simulated.image == pytest.approx(2 * place[0] - 3 * place[1], abs=5e-4)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.floats(-5, 5), st.floats(-5, 5), st.floats(-25, 25))
def test_it_is_linear_in_the_image(seed: int, a: float, b: float, tilt_deg: float) -> None:
    first, second = np.random.default_rng(seed).uniform(0, 255, (2, 41, 58))
    matrix = tilted(80.0, (58, 41), tilt_deg, 1.2)

    def follow_up(image: FloatArray) -> FloatArray:
        return np.asarray(
            simulate_pose_of_image(image, matrix, (58, 41), PSF, MATCHED).image, dtype=np.float64
        )

    combined = a * follow_up(first) + b * follow_up(second)
    assert follow_up(a * first + b * second) == pytest.approx(combined, abs=1e-8)


def test_two_zooms_with_a_turn_are_one() -> None:
    psf = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)
    image = blob((200, 240), np.array([110.0, 105.0]), 20 * np.eye(2))
    first = about_centre(1.5 * turn(20.0), (240, 200), (140, 120))
    second = about_centre(1.4 * turn(15.0), (140, 120), (80, 70))
    in_two = simulate_pose_of_image(
        simulate_pose_of_image(image, first, (140, 120), psf, MATCHED).image,
        second,
        (80, 70),
        psf,
        MATCHED,
    ).image
    at_once = simulate_pose_of_image(image, first @ second, (80, 70), psf, MATCHED).image
    assert in_two == pytest.approx(at_once, abs=1e-3 * at_once.max())


def test_a_camera_tilted_by_20_degrees_is_nearer_where_its_closed_form_says() -> None:
    size, focal_px, sigma2 = (780, 580), 8.0 / 0.0083, 0.935**2
    zoom = 1.0
    psf = GaussianPsf(sigma_x_px=0.935, sigma_y_px=0.935)
    simulated = simulate_pose_of_image(
        np.zeros((580, 780), np.float32), tilted(focal_px, size, 20.0, zoom), size, psf, MATCHED
    )
    # On the row through the axis, at the angle a from it, the derivative is height diag(k^2, k)
    # with k = cos(a) / cos(a + tilt): a ray cos(a + tilt) steep reaches height / cos(a + tilt)
    # far, and the plane is inclined to it once more along the row.
    middle = simulated.nearer[290]  # half a pixel off the axis
    angle = np.arctan((np.arange(780) - 389.5) / focal_px)
    k = np.cos(angle) / np.cos(angle + radians(20.0))
    height = zoom * cos(radians(20.0))
    along, across = ((height * s) ** 2 * sigma2 - sigma2 for s in (k**2, k))
    least = np.minimum(along, across)
    seen = ~simulated.outside[290]
    sure = seen & (np.abs(least + 1e-3) > 1e-3)
    assert (middle[sure] == (least[sure] < -1e-3)).all()
    # Worked by hand: 22.0 degrees from the axis at either end of the row.
    assert along[0] == pytest.approx(-0.30, abs=0.01)
    assert along[-1] == pytest.approx(1.00, abs=0.01)
    assert not (simulated.nearer & simulated.outside).any()


def test_an_indefinite_blur_keeps_its_positive_part() -> None:
    # Nearer along y, further along x: the rows are left as they are.
    image = blob((90, 160), np.array([80.0, 45.0]), np.diag([9.0, 9.0]))
    psf = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)
    matrix = about_centre(np.diag([2.0, 0.8]), (160, 90), (70, 80))
    simulated = simulate_pose_of_image(image, matrix, (70, 80), psf, MATCHED)
    assert simulated.nearer.all()
    missing = 3 * 0.64
    wider = blob((90, 160), np.array([80.0, 45.0]), np.diag([9.0 + missing, 9.0]))
    expected = simulate_pose_of_image(
        wider, matrix, (70, 80), GaussianPsf(sigma_x_px=1e-4, sigma_y_px=1e-4), MATCHED
    )
    assert simulated.image == pytest.approx(expected.image, abs=2e-4 * expected.image.max())


def test_an_oblique_indefinite_blur_keeps_its_positive_part() -> None:
    turned = turn(30.0)
    place = np.array([80.0, 45.0])
    image = blob((90, 160), place, 9 * np.eye(2))
    psf = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)
    matrix = about_centre(turned @ np.diag([2.0, 0.8]), (160, 90), (60, 60))
    simulated = simulate_pose_of_image(image, matrix, (60, 60), psf, MATCHED)
    inside = ~simulated.outside
    assert simulated.nearer[inside].all()
    missing = turned @ np.diag([3 * 0.64, 0.0]) @ turned.T
    wider = blob((90, 160), place, 9 * np.eye(2) + missing)
    expected = simulate_pose_of_image(
        wider, matrix, (60, 60), GaussianPsf(sigma_x_px=1e-4, sigma_y_px=1e-4), MATCHED
    )
    assert simulated.image == pytest.approx(expected.image, abs=2e-4 * expected.image.max())


def test_every_pixel_past_the_reference_is_outside_and_zero() -> None:
    matrix = np.array([[1.0, 0, -20.0], [0, 1.0, 10.25], [0, 0, 1]])
    simulated = simulate_pose_of_image(np.full((40, 60), 7.0), matrix, (60, 40), PSF, MATCHED)
    expected = np.zeros((40, 60), dtype=bool)
    expected[:, :20] = True
    # Row 29 lies at 39.25, within half a pixel of the last one.
    expected[30:, :] = True
    assert (simulated.outside == expected).all()
    assert (simulated.image[simulated.outside] == 0).all()
    assert simulated.image[~simulated.outside] == pytest.approx(7.0, rel=1e-6)


def test_tiles_leave_no_seam() -> None:
    # 1100 x 30 follow-up pixels are three tiles; each must see its neighbours' reference.
    image = np.random.default_rng(3).uniform(0, 255, (60, 1400))
    matrix = about_centre(1.2 * turn(0.4), (1400, 60), (1100, 30))
    whole = simulate_pose_of_image(image, matrix, (1100, 30), TILTED_PSF, MATCHED).image
    shift = np.eye(3)
    shift[0, 2] = 300
    part = simulate_pose_of_image(image, matrix @ shift, (500, 30), TILTED_PSF, MATCHED).image
    assert whole[:, 300:800] == pytest.approx(part, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_other_pixel_types_give_float32_of_the_same_values(dtype: type[np.generic]) -> None:
    image = PHOTOGRAPH.astype(dtype)
    before = image.copy()
    matrix = tilted(300.0, (280, 200), 10.0, 1.2)
    simulated = simulate_pose_of_image(image, matrix, (280, 200), PSF, MATCHED)
    assert simulated.image.dtype == np.float32
    exact = simulate_pose_of_image(PHOTOGRAPH, matrix, (280, 200), PSF, MATCHED)
    assert exact.image.dtype == np.float64
    assert simulated.image == pytest.approx(exact.image, abs=1e-5 * 255)
    assert (image == before).all()


@pytest.mark.slow
def test_colours_are_simulated_one_by_one() -> None:
    image = np.stack([PHOTOGRAPH, PHOTOGRAPH[::-1], PHOTOGRAPH[:, ::-1]], axis=-1)
    matrix = tilted(300.0, (280, 200), 10.0, 1.2)
    simulated = simulate_pose_of_image(image, matrix, (270, 190), PSF, MATCHED)
    assert simulated.image.shape == (190, 270, 3)
    for channel in range(3):
        grey = simulate_pose_of_image(image[:, :, channel], matrix, (270, 190), PSF, MATCHED)
        assert simulated.image[:, :, channel] == pytest.approx(grey.image, abs=1e-9)


def test_a_homography_counts_up_to_its_factor() -> None:
    matrix = tilted(300.0, (280, 200), 10.0, 1.2)
    first, second = (
        simulate_pose_of_image(PHOTOGRAPH, m, (280, 200), PSF, MATCHED)
        for m in (matrix, -7e3 * matrix)
    )
    assert first.image == pytest.approx(second.image, abs=1e-9)
    assert (first.nearer == second.nearer).all()


@pytest.mark.parametrize(
    "homography",
    [
        pytest.param(np.eye(2), id="of another shape"),
        pytest.param(np.full((3, 3), np.nan), id="not finite"),
        pytest.param(np.diag([1.0, 0.0, 1.0]), id="singular"),
        pytest.param(np.zeros((3, 3)), id="zero"),
        pytest.param(np.array([[1.0, 0, 0], [0, 1, 0], [-0.05, 0, 1]]), id="horizon in the frame"),
        pytest.param(np.array([[1.0, 0, 500], [0, 1, 0], [0, 0, 1]]), id="beside the reference"),
        pytest.param(np.diag([1.0, 100.0, 1.0]), id="blur wider than 32 px"),
    ],
)
def test_a_homography_that_no_pose_has_is_refused(homography: FloatArray) -> None:
    image = np.zeros((40, 60))
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, homography, (60, 40), PSF, MATCHED)


def test_wrong_images_sizes_and_psfs_are_refused() -> None:
    image = np.zeros((40, 60))
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, IDENTITY, (60, 40), None, MATCHED)
    for size in [(0, 40), (60, -1), (60.5, 40)]:
        with pytest.raises(ValueError):
            simulate_pose_of_image(image, IDENTITY, size, PSF, MATCHED)  # type: ignore[arg-type]
    with pytest.raises(ValueError):
        simulate_pose_of_image(np.zeros(5), IDENTITY, (60, 40), PSF, MATCHED)
    with pytest.raises(ValueError):
        simulate_pose_of_image(image.astype(np.int32), IDENTITY, (60, 40), PSF, MATCHED)
    with pytest.raises(ValueError):
        simulate_pose_of_image(np.full((40, 60), np.nan), IDENTITY, (60, 40), PSF, MATCHED)
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, IDENTITY, (60, 40), constant_field(61, 40, PSF), MATCHED)
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, IDENTITY, (30, 20), constant_field(60, 40, PSF), MATCHED)
    with pytest.raises(ValueError):
        simulate_pose_of_image(
            image, IDENTITY, (30, 20), constant_field(60, 40, PSF), PoseOptions(origin_px=(31, 0))
        )


@pytest.mark.parametrize("shift_px", [(0, 0), (7, -3)])
def test_a_follow_up_of_the_reference_s_own_pixels_is_the_reference(
    shift_px: tuple[int, int],
) -> None:
    # White noise, which every estimate between the pixels would smooth.
    image = np.random.default_rng(5).uniform(0, 255, (60, 80))
    right, down = shift_px
    matrix = np.array([[1.0, 0, right], [0, 1, down], [0, 0, 1]])
    seen = simulate_pose_of_image(
        image, matrix, (80, 60), GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)
    )
    expected = np.roll(image, (-down, -right), axis=(0, 1))
    # The spline through the pixels gives them back to the length of its inverse.
    inner = np.s_[16:-16, 16:-16]
    np.testing.assert_allclose(seen.image[inner], expected[inner], atol=0.02)


SIZE = (150, 130)
GRID = SamplingGrid(zoom_y=1.4, zoom_x=1.8, origin_y_px=33.2, origin_x_px=-20.4, rows=130, cols=150)
MIRRORED = np.array([[-1.5, 0, 290.0], [0, 1.2, -30.3], [0, 0, 1]])
TURN = 1e-13
"""Enough to make every pixel a case of its own, and too little to move any."""


@pytest.mark.parametrize("model", POSE_MODELS)
@pytest.mark.parametrize("matrix", [GRID.matrix, MIRRORED], ids=["beyond the edge", "mirrored"])
def test_a_zoom_is_the_limit_of_one_that_is_turned(
    matrix: np.ndarray[tuple[int, int], np.dtype[np.float64]], model: PoseModel
) -> None:
    options = PoseOptions(model=model)
    turned = matrix + TURN * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
    zoomed = simulate_pose_of_image(PHOTOGRAPH, matrix, SIZE, TILTED_PSF, options)
    limit = simulate_pose_of_image(PHOTOGRAPH, turned, SIZE, TILTED_PSF, options)
    assert limit.outside.any()
    np.testing.assert_array_equal(zoomed.outside, limit.outside)
    np.testing.assert_array_equal(zoomed.nearer, limit.nearer)
    np.testing.assert_allclose(zoomed.image, limit.image, rtol=0, atol=1e-9 * 255)


def test_a_zoom_follows_a_psf_that_varies() -> None:
    rows, cols = PHOTOGRAPH.shape[:2]
    coefficients = np.zeros((3, 3))
    coefficients[[0, 2], 0] = 0.6
    coefficients[[0, 2], 1] = 0.4
    field = PsfField(width_px=cols, height_px=rows, coefficients_px2=coefficients)
    matrix = np.diag([-1.05, 1.05, 1.0])
    matrix[0, 2] = cols
    turned = matrix + TURN * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
    options = PoseOptions(model="matched", origin_px=(0.0, 0.0))
    zoomed = simulate_pose_of_image(PHOTOGRAPH, matrix, (cols, rows), field, options)
    limit = simulate_pose_of_image(PHOTOGRAPH, turned, (cols, rows), field, options)
    assert zoomed.nearer.any()
    assert not zoomed.nearer.all()
    np.testing.assert_array_equal(zoomed.nearer, limit.nearer)
    # A zoom has the kernels of its pixels, any other view those of the reference's around them.
    assert np.sqrt(np.mean((zoomed.image - limit.image) ** 2)) < 0.05


@pytest.mark.slow
def test_an_even_field_is_one_psf() -> None:
    matrix = tilted(300.0, (280, 200), 15.0, 1.2)
    one = simulate_pose_of_image(PHOTOGRAPH, matrix, (280, 200), TILTED_PSF)
    field = simulate_pose_of_image(
        PHOTOGRAPH, matrix, (280, 200), constant_field(280, 200, TILTED_PSF)
    )
    assert field.image == pytest.approx(one.image, abs=1e-9)
    assert (field.nearer == one.nearer).all()


def test_a_shift_over_a_field_blurs_by_the_difference_of_its_two_places() -> None:
    # Sigma grows to the right by 1 px^2 per r; the follow-up sees everything 40 px further right.
    size, shift = (201, 101), 40
    coefficients = np.zeros((3, 3))
    coefficients[[0, 2], 0] = 1.5
    coefficients[[0, 2], 1] = 1.0
    field = PsfField(width_px=size[0], height_px=size[1], coefficients_px2=coefficients)
    matrix = np.array([[1.0, 0, -shift], [0, 1, 0], [0, 0, 1]])
    image = blob((101, 201), np.array([70.0, 50.0]), 9 * np.eye(2))
    simulated = simulate_pose_of_image(image, matrix, size, field)
    seen = ~simulated.outside
    assert not simulated.nearer.any()
    gained = shift / field.corner_radius_px
    expected = blob((101, 201), np.array([110.0, 50.0]), (9 + gained) * np.eye(2))
    # The common blur's kernel is cut as zoom_out's is: 5e-4 of the peak.
    assert simulated.image[seen] == pytest.approx(expected[seen], abs=1e-3 * expected.max())
    # Back to the left the follow-up is the sharper one.
    back = simulate_pose_of_image(image, np.linalg.inv(matrix), size, field)
    assert back.nearer[~back.outside].all()


@pytest.mark.slow
def test_a_part_of_the_follow_up_has_the_psf_of_its_place_in_the_frame() -> None:
    coefficients = np.zeros((3, 6))
    coefficients[[0, 2], 0] = 0.5
    coefficients[[0, 2], 1:] = 0.1, -0.05, 0.2, 0.0, 0.3
    field = PsfField(width_px=280, height_px=200, coefficients_px2=coefficients)
    matrix = tilted(300.0, (280, 200), 10.0, 1.2)
    whole = simulate_pose_of_image(PHOTOGRAPH, matrix, (280, 200), field).image
    moved = matrix @ np.array([[1.0, 0, 60], [0, 1, 30], [0, 0, 1]])
    part = simulate_pose_of_image(
        PHOTOGRAPH, moved, (150, 120), field, PoseOptions(origin_px=(60.0, 30.0))
    ).image
    # The common blur is chosen for what is seen, and its kernel is cut off at 1e-3 of 255.
    assert part == pytest.approx(whole[30:150, 60:210], abs=0.6)
    wrong = simulate_pose_of_image(
        PHOTOGRAPH, moved, (150, 120), field, PoseOptions(origin_px=(0.0, 0.0))
    ).image
    assert abs(wrong - whole[30:150, 60:210]).max() > 1


MORE_TILTED_PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=0.4)


def test_a_follow_up_from_the_same_place_keeps_the_noise() -> None:
    gain = pose_noise_gain(np.eye(3), (30, 40), (40, 30), PSF, MATCHED)
    assert gain == pytest.approx(np.ones((30, 40)), abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("psf", [PSF, MORE_TILTED_PSF])
@pytest.mark.parametrize("zooms", [(1.0, 1.0), (1.1, 1.1), (1.37, 1.37), (2.0, 1.6)])
def test_an_axial_follow_up_has_the_exact_sum_of_squared_weights(
    psf: GaussianPsf, zooms: tuple[float, float]
) -> None:
    # The exact sum comes from the operator itself, which is another code path.
    grid = SamplingGrid(
        zoom_y=zooms[0], zoom_x=zooms[1], origin_y_px=30.3, origin_x_px=30.6, rows=25, cols=30
    )
    shape = (150, 160)
    exact = propagated_variance(zoom_operator(shape, grid, psf, "matched"), np.ones(shape))
    gain = pose_noise_gain(grid.matrix, shape, (30, 25), psf, MATCHED)
    # The operator's bands are short: its sums are off by up to 1.09 % at zoom 1.37 with rho 0.4.
    assert gain == pytest.approx(exact, rel=1.2e-2)


@pytest.mark.slow
def test_a_tilted_follow_up_has_the_scatter_of_simulated_noise() -> None:
    shape, size = (200, 280), (280, 200)
    matrix = tilted(300.0, size, 20.0, 1.3)
    rng = np.random.default_rng(5)
    count = 60
    squares = np.zeros(shape)
    for _ in range(count):
        squares += (
            simulate_pose_of_image(
                rng.normal(size=shape), matrix, size, MORE_TILTED_PSF, MATCHED
            ).image
            ** 2
        )
    inside = ~simulate_pose_of_image(
        np.zeros(shape), matrix, size, MORE_TILTED_PSF, MATCHED
    ).outside
    inside[:12], inside[-12:], inside[:, :12], inside[:, -12:] = False, False, False, False
    gain = pose_noise_gain(matrix, shape, size, MORE_TILTED_PSF, MATCHED)
    # Strips across the tilt, of some 5000 correlated pixels: 60 draws scatter by about 0.5 %.
    for left in range(0, 280, 40):
        strip = np.s_[:, left : left + 40]
        chosen = inside[strip]
        if chosen.sum() < 2000:
            continue
        measured = (squares[strip] / count)[chosen].mean()
        assert measured == pytest.approx(gain[strip][chosen].mean(), rel=0.02)
    assert gain[inside].max() > 1.5 * gain[inside].min()


def test_a_missing_psf_is_refused() -> None:
    with pytest.raises(ValueError):
        pose_noise_gain(np.eye(3), (30, 40), (40, 30), None, MATCHED)
