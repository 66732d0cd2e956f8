from math import radians

import pytest

from calibration.edges import EdgeImage, measure_edges
from calibration.sharpness import edge_row, reported_mtf50
from tests.calibration.closed_form import edge_image
from tests.calibration.diffraction import diffracted_edge, system_mtf50
from tests.calibration.sharpness.edges import edge_of

CUTOFF, NORMAL_DEG = 2.5, 4.0


def test_mtf50_of_a_table_is_the_measured_one_and_the_gaussians_is_named_so() -> None:
    [edge] = measure_edges(EdgeImage(name="e", image_dn=diffracted_edge(CUTOFF, NORMAL_DEG)))
    row = edge_row(edge)
    truth = system_mtf50(CUTOFF, radians(NORMAL_DEG))
    assert row["mtf50_cy_per_px"] == pytest.approx(truth, rel=1e-3)
    assert row["mtf50_err_cy_per_px"] == reported_mtf50(edge).err_cy_per_px
    assert row["mtf50_from"] == "e-SFR"
    # A Gaussian has no tails: it is some 2 % low, and stands under its own name alone.
    assert row["gaussian_mtf50_cy_per_px"] == edge.mtf50_cy_per_px
    assert row["gaussian_mtf50_cy_per_px"] < 0.99 * truth


def test_of_a_gaussian_lens_both_are_the_same() -> None:
    [edge] = measure_edges(EdgeImage(name="e", image_dn=edge_image(0.8, 5.0)))
    row = edge_row(edge)
    assert row["mtf50_cy_per_px"] == pytest.approx(row["gaussian_mtf50_cy_per_px"], rel=1e-3)


def test_every_unit_is_of_the_same_mtf50() -> None:
    measured = {"cy_per_px": 0.25, "err_cy_per_px": 0.01, "lw_per_ph": 200.0, "lp_per_mm": 50.0}
    gaussian = {"cy_per_px": 0.2, "err_cy_per_px": 0.02, "lw_per_ph": 160.0, "lp_per_mm": 40.0}
    edge = edge_of(
        **{f"mtf50_{unit}": value for unit, value in gaussian.items()},
        **{f"esfr_mtf50_{unit}": value for unit, value in measured.items()},
    )
    row = edge_row(edge)
    assert {unit: row[f"mtf50_{unit}"] for unit in measured} == measured
    assert {unit: row[f"gaussian_mtf50_{unit}"] for unit in gaussian} == gaussian
    without = edge_row(edge.model_copy(update={"esfr_mtf50_err_cy_per_px": None}))
    assert {unit: without[f"mtf50_{unit}"] for unit in gaussian} == gaussian
    assert without["mtf50_from"] == "gaussian"
    assert without["esfr_mtf50_cy_per_px"] == 0.25
