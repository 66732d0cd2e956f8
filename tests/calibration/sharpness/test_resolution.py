import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.edges import EdgeImage, gaussian_mtf50, measure_edges, pixel_mtf50
from calibration.sharpness import lp_per_mm, lw_per_ph, reported_mtf50, with_sharpness
from calibration.sharpness.resolution import gaussian_mtf50_err, picture_height_px
from tests.calibration.closed_form import edge_image
from tests.calibration.sharpness.edges import edge_of


def test_units_are_those_of_the_standard() -> None:
    # By hand: two line widths a cycle, 480 rows; 0.25 cycles on 5 um are 50 on a millimetre.
    assert lw_per_ph(0.25, 480) == 240.0
    assert lp_per_mm(0.25, 5.0) == 50.0


@given(sigma=st.floats(0.4, 3.0), share=st.floats(1e-4, 0.1))
def test_a_frequency_inverse_to_the_width_has_its_relative_error(
    sigma: float, share: float
) -> None:
    edge = edge_of(
        sigma_px=sigma,
        sigma_err_px=share * sigma,
        optical_sigma_px=None,
        optical_sigma_err_px=None,
        mtf50_cy_per_px=gaussian_mtf50(sigma),
    )
    assert gaussian_mtf50_err(edge) == pytest.approx(share * gaussian_mtf50(sigma), rel=1e-12)


@given(sigma=st.floats(0.2, 3.0), angle_deg=st.floats(0, 180, exclude_max=True))
def test_the_error_behind_a_pixel_is_the_slope_of_the_frequency_over_the_width(
    sigma: float, angle_deg: float
) -> None:
    normal = float(np.deg2rad(angle_deg + 90.0))
    edge = edge_of(
        angle_deg,
        optical_sigma_px=sigma,
        optical_sigma_err_px=1.0,
        mtf50_cy_per_px=pixel_mtf50(sigma, normal),
    )
    step = 1e-5
    slope = (pixel_mtf50(sigma - step, normal) - pixel_mtf50(sigma + step, normal)) / (2 * step)
    # Central differences of a root known to 1e-12 are good to 1e-7.
    assert gaussian_mtf50_err(edge) == pytest.approx(slope, rel=1e-5)


def test_the_e_sfr_is_reported_where_it_has_an_error_and_else_the_gaussian() -> None:
    measured = edge_of(esfr_mtf50_cy_per_px=0.25, esfr_mtf50_err_cy_per_px=0.01)
    assert reported_mtf50(measured).cy_per_px == 0.25
    assert reported_mtf50(measured).is_model_free
    assert reported_mtf50(measured).reach_95_cy_per_px == pytest.approx(0.0196, abs=1e-6)
    for missing in ("esfr_mtf50_cy_per_px", "esfr_mtf50_err_cy_per_px"):
        other = reported_mtf50(measured.model_copy(update={missing: None}))
        assert other.cy_per_px == measured.mtf50_cy_per_px
        assert not other.is_model_free


def test_an_edge_gets_the_units_of_its_own_photograph() -> None:
    source = EdgeImage(name="edge", image_dn=edge_image(0.8, 5.0), pixel_pitch_um=4.0)
    [plain] = measure_edges(source)
    [edge] = with_sharpness([plain], source)
    rows = source.image_dn.shape[0]
    assert edge.mtf50_lw_per_ph == pytest.approx(2 * rows * edge.mtf50_cy_per_px)
    assert edge.mtf50_lp_per_mm == pytest.approx(250 * edge.mtf50_cy_per_px)
    assert edge.esfr_mtf50_cy_per_px is not None
    assert edge.esfr_mtf50_lp_per_mm == pytest.approx(250 * edge.esfr_mtf50_cy_per_px)
    assert picture_height_px(edge) == pytest.approx(rows)
    assert picture_height_px(plain) is None


def test_without_a_pixel_pitch_there_are_no_line_pairs() -> None:
    source = EdgeImage(name="edge", image_dn=edge_image(0.8, 5.0))
    [edge] = with_sharpness(measure_edges(source), source)
    assert edge.mtf50_lp_per_mm is None
    assert edge.esfr_mtf50_lp_per_mm is None
    assert edge.red_shift_px is None
