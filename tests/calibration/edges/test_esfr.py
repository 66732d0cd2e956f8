import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.edges import (
    SFR_FREQ_CY_PER_PX,
    BinnedEdge,
    EdgeFit,
    EdgeImage,
    EdgeMeasurement,
    EdgeSamples,
    bin_edge,
    edges_of_image,
    gaussian_mtf50,
    measure_esfr,
    pixel_mtf50,
)
from calibration.edges._esfr import EdgeSfr, is_aliased, widest_gap_px
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image, pixel_edge, point_edge
from tests.calibration.diffraction import diffracted_edge, system_mtf, system_mtf50
from tests.calibration.known import known


def test_the_mtf50_of_a_gaussian_by_hand() -> None:
    # exp(-2 pi^2 f^2) = 1/2 at f = sqrt(ln 2 / 2) / pi.
    assert gaussian_mtf50(1.0) == pytest.approx(0.187390625, rel=1e-8)
    assert gaussian_mtf50(0.5) == pytest.approx(2 * 0.187390625, rel=1e-8)


@pytest.mark.parametrize(
    ("normal_deg", "frequency"),
    [
        (0.0, 0.603354564),  # sinc(f) = 1/2
        (45.0, 0.626420906),  # sinc(f / sqrt 2)^2 = 1/2
        (90.0, 0.603354564),
    ],
)
def test_a_perfect_lens_leaves_the_pixel_square(normal_deg: float, frequency: float) -> None:
    assert pixel_mtf50(1e-9, np.deg2rad(normal_deg)) == pytest.approx(frequency, rel=1e-6)


@pytest.mark.parametrize("normal_deg", [0.0, 12.0, 45.0])
@pytest.mark.parametrize("sigma_px", [0.3, 0.6, 1.2])
def test_half_the_contrast_of_the_exact_edge_is_left(sigma_px: float, normal_deg: float) -> None:
    normal = float(np.deg2rad(normal_deg))
    frequency = pixel_mtf50(sigma_px, normal)
    # The transfer is the Fourier transform of the line spread function, the edge's derivative.
    distance = np.arange(-12.0, 12.0, 0.01)
    line = np.diff(pixel_edge(distance, sigma_px, normal))
    transfer = np.sum(line * np.cos(2 * np.pi * frequency * (distance[:-1] + 0.005)))
    assert transfer == pytest.approx(0.5, abs=2e-4)  # steps of 0.01 px


def test_a_wide_psf_hides_the_shape_of_the_pixel() -> None:
    total = np.sqrt(3.0**2 + 1 / 12)
    assert pixel_mtf50(3.0, 0.4) == pytest.approx(gaussian_mtf50(float(total)), rel=1e-4)


@given(sigma=st.floats(0.05, 5.0), turn=st.floats(-7.0, 7.0))
def test_mirrored_and_turned_edges_have_the_same_mtf50(sigma: float, turn: float) -> None:
    frequency = pixel_mtf50(sigma, turn)
    assert pixel_mtf50(sigma, -turn) == pytest.approx(frequency)
    assert pixel_mtf50(sigma, turn + np.pi / 2) == pytest.approx(frequency)


@given(sigma=st.floats(0.05, 5.0), factor=st.floats(1.001, 3.0), turn=st.floats(0.0, 3.2))
def test_a_wider_psf_has_a_lower_mtf50(sigma: float, factor: float, turn: float) -> None:
    assert pixel_mtf50(sigma * factor, turn) < pixel_mtf50(sigma, turn)
    assert gaussian_mtf50(sigma * factor) < gaussian_mtf50(sigma)


def measured(image: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> EdgeMeasurement:
    [edge] = edges_of_image(EdgeImage(name="edge.tif", image_dn=image))
    return edge


def curve(edge: EdgeMeasurement) -> EdgeSfr:
    assert edge.esfr is not None
    return edge.esfr


@pytest.mark.parametrize("normal_deg", [3.0, 97.0, 140.0])
@pytest.mark.parametrize("sigma_px", [0.4, 0.8, 2.0])
def test_a_point_sampled_gaussian_has_its_mtf50(sigma_px: float, normal_deg: float) -> None:
    esfr = curve(measured(edge_image(sigma_px, normal_deg)))
    # 0.05 % was asked for; the spline's knots of 0.25 px leave 0.005 %.
    assert esfr.mtf50_cy_per_px == pytest.approx(gaussian_mtf50(sigma_px), rel=1e-4)
    # exp(-2 pi^2 s^2 f^2) = 0.2
    twenty = np.sqrt(np.log(5) / 2) / (np.pi * sigma_px)
    assert esfr.mtf20_cy_per_px == pytest.approx(twenty, rel=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("normal_deg", [17.0, 93.0, 140.0])
@pytest.mark.parametrize("sigma_px", [0.3, 0.5, 1.2])
def test_a_gaussian_behind_square_pixels_has_its_mtf50(sigma_px: float, normal_deg: float) -> None:
    esfr = curve(measured(edge_image(sigma_px, normal_deg, has_pixel=True)))
    truth = pixel_mtf50(sigma_px, float(np.deg2rad(normal_deg)))
    assert esfr.mtf50_cy_per_px == pytest.approx(truth, rel=1e-4)


@pytest.mark.parametrize("cutoff", [0.4, 0.7, 1.2, 2.5])
def test_a_diffraction_limited_lens_has_its_whole_curve(cutoff: float) -> None:
    for normal_deg in (4.0, 140.0):
        normal = float(np.deg2rad(normal_deg))
        esfr = curve(measured(diffracted_edge(cutoff, normal_deg)))
        # Its tails fall as 1 / x^2: without them the curve would be 1 % high.
        assert esfr.mtf50_cy_per_px == pytest.approx(system_mtf50(cutoff, normal), rel=1e-3)
        freq = np.array(SFR_FREQ_CY_PER_PX)
        np.testing.assert_allclose(esfr.at(freq), system_mtf(freq, cutoff, normal), atol=2e-3)


@pytest.mark.slow
def test_with_noise_the_median_error_is_half_a_percent_and_the_own_error_honest() -> None:
    rng = np.random.default_rng(2)
    errors, pulls = [], []
    for cutoff in (0.35, 0.5, 0.7, 1.0, 1.5, 2.5):
        for normal_deg in (4.0, 19.0, 95.0, 140.0):
            clean = diffracted_edge(cutoff, normal_deg)
            truth = system_mtf50(cutoff, float(np.deg2rad(normal_deg)))
            esfr = curve(measured(clean + rng.normal(size=clean.shape) * 440.0))
            assert esfr.mtf50_cy_per_px is not None
            assert esfr.mtf50_err_cy_per_px is not None
            errors.append(esfr.mtf50_cy_per_px / truth - 1)
            pulls.append((esfr.mtf50_cy_per_px - truth) / esfr.mtf50_err_cy_per_px)
    # At an SNR of 100; the median of 24 draws scatters by about 25 %.
    assert np.median(np.abs(errors)) < 0.0065
    assert 0.6 < np.std(pulls) < 1.3


def test_one_hot_pixel_and_its_like_do_not_count() -> None:
    image = edge_image(0.8, 5.0)
    clean = curve(measured(image)).mtf50_cy_per_px
    image[40, 58] = 65_000.0
    image[20, 50] = 0.0
    assert curve(measured(image)).mtf50_cy_per_px == pytest.approx(clean, rel=1e-4)


def binned(distance: FloatArray, unit_levels: FloatArray, sigma_px: float = 0.7) -> BinnedEdge:
    """Pixels at given distances from an edge that was fitted with a plain Gaussian."""
    samples = EdgeSamples(
        distance_px=distance,
        along_px=np.zeros_like(distance),
        levels_dn=100 + 900 * unit_levels,
        low_dn=100.0,
        high_dn=1000.0,
        normal_rad=0.1,
        half_length_px=30.0,
    )
    fit = EdgeFit(
        x_px=0.0,
        y_px=0.0,
        angle_deg=95.7,
        length_px=60.0,
        sigma_px=sigma_px,
        sigma_err_px=0.001,
        optical_sigma_px=None,
        optical_sigma_err_px=None,
        low_dn=100.0,
        high_dn=1000.0,
        noise_dn=1.0,
        curvature_per_px=0.0,
        chi2_reduced=None,
        flags=(),
    )
    return known(bin_edge(samples, fit))


def spread(seed: int, reach_px: float = 15.0, size: int = 6000) -> FloatArray:
    return np.random.default_rng(seed).uniform(-reach_px, reach_px, size)


@settings(max_examples=20, deadline=None)
@given(shift=st.floats(-0.3, 0.3), seed=st.integers(0, 10_000))
def test_the_modulus_does_not_depend_on_where_the_edge_lies(shift: float, seed: int) -> None:
    distance = spread(seed)
    freq = np.array(SFR_FREQ_CY_PER_PX)
    here = known(measure_esfr(binned(distance, point_edge(distance, 0.7))))
    there = known(measure_esfr(binned(distance + shift, point_edge(distance, 0.7))))
    np.testing.assert_allclose(here.at(freq), there.at(freq), atol=2e-4)
    assert there.at(np.zeros(1))[0] == pytest.approx(1.0, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(start=st.floats(0.5, 1.2), sigma=st.floats(0.5, 1.2), seed=st.integers(0, 10_000))
def test_the_curve_does_not_depend_on_the_gaussian_it_starts_from(
    start: float, sigma: float, seed: int
) -> None:
    distance = spread(seed)
    found = known(measure_esfr(binned(distance, point_edge(distance, sigma), start)))
    # A Gaussian twice too wide bends within a bin by up to 1e-3 of the contrast.
    assert found.mtf50_cy_per_px == pytest.approx(gaussian_mtf50(sigma), rel=2e-3)


def test_an_edge_sharper_than_the_pixel_grid_has_no_mtf20_below_1_cy_per_px() -> None:
    esfr = curve(measured(edge_image(0.2, 5.0)))
    # By hand: exp(-2 pi^2 0.04) = 0.454 at 1 cy/px.
    assert esfr.mtf20_cy_per_px is None
    assert esfr.mtf50_cy_per_px == pytest.approx(gaussian_mtf50(0.2), rel=2e-3)


def test_an_edge_that_falls_along_its_normal_has_no_curve() -> None:
    distance = spread(2)
    assert measure_esfr(binned(distance, point_edge(-distance, 0.7))) is None


def test_an_edge_far_sharper_than_the_pixel_grid_has_no_mtf50_below_1_cy_per_px() -> None:
    distance = spread(3)
    found = known(measure_esfr(binned(distance, point_edge(distance, 0.12), 0.12)))
    # By hand: exp(-2 pi^2 0.12^2) = 0.753 at 1 cy/px.
    assert found.at(np.ones(1))[0] == pytest.approx(0.753, abs=0.02)
    assert found.mtf50_cy_per_px is None
    assert found.mtf50_err_cy_per_px is None


def test_profiles_are_those_of_the_edge_and_integrate_to_one() -> None:
    distance = spread(4)
    found = known(measure_esfr(binned(distance, point_edge(distance, 0.8))))
    at = np.linspace(-6, 6, 241)
    np.testing.assert_allclose(found.esf(at), point_edge(at, 0.8), atol=1e-3)
    density = np.exp(-0.5 * (at / 0.8) ** 2) / (0.8 * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(found.lsf(at), density, atol=2e-3)
    assert float(np.trapezoid(found.lsf(at), at)) == pytest.approx(1.0, abs=1e-3)


def test_the_errors_of_the_transform_are_the_scatter_over_draws() -> None:
    freq = np.array([0.1, 0.3, 0.5])
    truth = np.exp(-2 * (np.pi * 0.7 * freq) ** 2)
    pulls = []
    for seed in range(60):
        distance = spread(seed, size=3000)
        noise = np.random.default_rng(1000 + seed).normal(size=distance.size) / 50
        found = known(measure_esfr(binned(distance, point_edge(distance, 0.7) + noise)))
        pulls.append((found.transform(freq).real - truth) / found.transform_err(freq))
    # 60 draws know a standard deviation to 9 %; a true Gaussian is the prior's own middle.
    assert np.all(np.std(pulls, axis=0) < 1 + 3.3 * 0.09)
    assert np.all(np.std(pulls, axis=0) > 0.6)


@pytest.mark.slow
@pytest.mark.parametrize("normal_deg", [0.0, 0.1, 0.3, 1.0, 18.435, 26.565, 45.0, 90.0])
@pytest.mark.parametrize("sigma_px", [0.3, 0.5, 0.7, 1.2])
def test_at_every_angle_mtf50_is_right_or_said_to_be_missing(
    sigma_px: float, normal_deg: float
) -> None:
    edge = measured(edge_image(sigma_px, normal_deg, has_pixel=True))
    truth = pixel_mtf50(sigma_px, float(np.deg2rad(normal_deg)))
    if edge.esfr is None:
        assert edge.esfr_missing is not None
        assert edge.binned is not None
        assert widest_gap_px(edge.binned) > 0.5
        assert sigma_px < 0.6
    else:
        assert edge.esfr_missing is None
        # 0.3 % is asked for; the fit's last step is 1e-4 px, and of a sharp edge along the rows
        # few pixels tell the angle.
        assert edge.esfr_mtf50_cy_per_px == pytest.approx(truth, rel=1e-3)


def test_gaps_between_the_distances_are_those_of_the_angle() -> None:
    for normal_deg, gap_px in ((0.0, 1.0), (45.0, np.sqrt(0.5)), (26.565, np.sqrt(0.2))):
        edge = known(measured(edge_image(0.8, normal_deg, has_pixel=True)).binned)
        assert widest_gap_px(edge) == pytest.approx(gap_px, abs=0.01)
        assert not is_aliased(edge, gap_px)


def test_a_wide_tail_is_told_from_the_middle() -> None:
    # A tenth of the light in a Lorentzian of half width 2 px: exp(-2 pi 2 f) in closed form.
    distance = spread(5, 25.0, 12_000)
    levels = 0.9 * point_edge(distance, 0.7) + 0.1 * (0.5 + np.arctan(distance / 2) / np.pi)
    found = known(measure_esfr(binned(distance, levels)))
    freq = np.array(SFR_FREQ_CY_PER_PX)
    truth = 0.9 * np.exp(-2 * (np.pi * 0.7 * freq) ** 2) + 0.1 * np.exp(-4 * np.pi * freq)
    np.testing.assert_allclose(found.at(freq), truth, atol=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("amount", [0.15, 0.35])
@pytest.mark.parametrize("normal_deg", [4.0, 40.0])
def test_light_that_falls_off_costs_neither_width_nor_contrast(
    amount: float, normal_deg: float
) -> None:
    image = edge_image(0.8, normal_deg, shape=(160, 160), has_pixel=True)
    truth = pixel_mtf50(0.8, float(np.deg2rad(normal_deg)))
    y, x = (np.mgrid[:160, :160] - 79.5) / 160
    for light, most in ((1 + amount * x, 0.005), (1 - 2 * amount * (x**2 + y**2), 0.01)):
        for edge in edges_of_image(EdgeImage(name="", image_dn=image * light)):
            assert edge.optical_sigma_px == pytest.approx(0.8, rel=most)
            assert edge.esfr_mtf50_cy_per_px == pytest.approx(truth, rel=most)


def test_a_contrast_that_contradicts_the_gaussian_is_flagged() -> None:
    # Two edges 1.5 px apart, as camera shake makes them: no Gaussian has their contrast.
    y, x = np.mgrid[:90, :110].astype(np.float64)
    across = np.cos(0.09) * (x - 54.5) + np.sin(0.09) * (y - 44.5)
    shaken = 0.5 * (point_edge(across - 1.0, 0.5) + point_edge(across + 1.0, 0.5))
    noise = np.random.default_rng(1).normal(size=x.shape) * 200
    edge = measured(8_000 + 44_000 * shaken + noise)
    assert "esfr_differs" in edge.flags
    # By hand: exp(-2 pi^2 0.25 f^2) cos(2 pi f) = 0.5.
    assert edge.esfr_mtf50_cy_per_px == pytest.approx(0.15486, rel=0.02)
    assert "esfr_differs" not in measured(edge_image(0.8, 5.0) + noise).flags
