from dataclasses import replace

import numpy as np
import pytest

from calibration.psf import FieldFit, psf_of_images
from calibration.psf._field import FieldEdges, field_or_reason, fit_psf_field
from simulation.arrays import FloatArray
from simulation.psf.shapes import PsfField
from tests.calibration.edge_field import COLS, FIELD, ROWS, frame_of_edges
from tests.calibration.known import known

CONSTANT = PsfField(
    width_px=COLS,
    height_px=ROWS,
    coefficients_px2=FIELD.coefficients_px2 * np.array([1, 0, 0, 0, 0, 0]),
)
NORMALS_DEG = (0.0, 45.0, 90.0, 135.0)


def width_of(
    field: PsfField, x: FloatArray, y: FloatArray, normal_deg: FloatArray | float
) -> FloatArray:
    turn = np.deg2rad(np.asarray(normal_deg, dtype=np.float64))
    normal = np.stack(np.broadcast_arrays(np.cos(turn), np.sin(turn)), axis=-1)
    return np.asarray(
        np.sqrt(np.einsum("...i,...ij,...j->...", normal, field.covariance_px2(x, y), normal))
    )


def edges_over_the_frame(
    field: PsfField, count: int = 80, err: float = 0.004, seed: int = 1, scale: float = 1.0
) -> FieldEdges:
    """Widths as edges of known place and direction would give them, with Gaussian errors."""
    rng = np.random.default_rng(seed)
    x = (COLS - 1) * (0.5 + scale * (rng.uniform(0, 1, count) - 0.5))
    y = (ROWS - 1) * (0.5 + scale * (rng.uniform(0, 1, count) - 0.5))
    angle = (np.arange(count) * 22.5 + rng.uniform(-5, 5, count)) % 180
    sigma = width_of(field, x, y, angle + 90)
    noisy = sigma + rng.normal(size=count) * err
    errs = np.full(count, err if err > 0 else 1e-6)
    return FieldEdges(x_px=x, y_px=y, angle_deg=angle, sigma_px=noisy, sigma_err_px=errs)


def worst(fit: FieldFit | None) -> float:
    """Largest relative error of a width anywhere in the frame, in four directions."""
    assert fit is not None
    x, y = np.linspace(0, COLS - 1, 9)[None, :], np.linspace(0, ROWS - 1, 9)[:, None]
    return max(
        float(np.abs(width_of(fit.total, x, y, n) / width_of(FIELD, x, y, n) - 1).max())
        for n in NORMALS_DEG
    )


def test_exact_widths_give_the_exact_field() -> None:
    fit = known(fit_psf_field(edges_over_the_frame(FIELD, err=0.0), COLS, ROWS))
    np.testing.assert_allclose(fit.coefficients_px2, FIELD.coefficients_px2, rtol=1e-6, atol=1e-8)


def test_the_errors_of_the_coefficients_are_those_of_repetition() -> None:
    fits = [fit_psf_field(edges_over_the_frame(FIELD, seed=s), COLS, ROWS) for s in range(40)]
    values = np.array([f.coefficients_px2 for f in fits if f is not None])
    errs = np.array([f.coefficients_err_px2 for f in fits if f is not None])
    assert len(values) == 40
    ratio = values.std(axis=0, ddof=1) / np.median(errs, axis=0)
    # 18 standard deviations from 40 draws each: their mean is good to 3 %, places vary.
    assert 0.85 < ratio.mean() < 1.2


def test_one_psf_for_the_frame_is_kept_where_nothing_asks_for_more() -> None:
    found = [
        fit_psf_field(edges_over_the_frame(CONSTANT, seed=s), COLS, ROWS) is not None
        for s in range(40)
    ]
    assert sum(found) <= 1  # the test asks at p = 0.001


@pytest.mark.parametrize("count", [10, 35])
def test_few_edges_have_no_field(count: int) -> None:
    assert fit_psf_field(edges_over_the_frame(FIELD, count), COLS, ROWS) is None


def test_edges_in_the_middle_alone_do_not_tell_of_the_corners() -> None:
    assert fit_psf_field(edges_over_the_frame(FIELD, scale=0.3), COLS, ROWS) is None


def test_vertical_and_horizontal_edges_alone_do_not_determine_the_tilt() -> None:
    edges = edges_over_the_frame(FIELD)
    axial = np.where(np.arange(80) % 2 == 0, 0.0, 90.0)
    turned = FieldEdges(
        x_px=edges.x_px,
        y_px=edges.y_px,
        angle_deg=axial,
        sigma_px=width_of(FIELD, edges.x_px, edges.y_px, axial + 90),
        sigma_err_px=edges.sigma_err_px,
    )
    assert fit_psf_field(turned, COLS, ROWS) is None
    reason = field_or_reason(turned, COLS, ROWS)
    assert isinstance(reason, str)
    assert "too few directions" in reason
    assert "the widths along the axes change over the frame" in reason


@pytest.mark.parametrize(
    ("edges", "expected"),
    [
        (edges_over_the_frame(FIELD, 35), "too few edges: 35 of at least 36"),
        (edges_over_the_frame(CONSTANT), "no change over the frame"),
        (edges_over_the_frame(FIELD, err=0.05), "would be known to"),
        (replace(edges_over_the_frame(FIELD), x_px=np.full(80, 9.0)), "too few places"),
        (
            replace(edges_over_the_frame(CONSTANT), angle_deg=np.tile([2.0, 92.0], 40)),
            "the widths along the axes do not change significantly",
        ),
        (replace(edges_over_the_frame(FIELD), angle_deg=np.full(80, 3.0)), "too few directions"),
    ],
)
def test_what_stands_in_the_way_of_a_field_is_said(edges: FieldEdges, expected: str) -> None:
    reason = field_or_reason(edges, COLS, ROWS)
    assert isinstance(reason, str)
    assert expected in reason


def test_single_wrong_edges_do_not_bend_the_field() -> None:
    edges = edges_over_the_frame(FIELD)
    wrong = edges.sigma_px.copy()
    wrong[[7, 40]] *= 1.6
    spoilt = FieldEdges(
        x_px=edges.x_px,
        y_px=edges.y_px,
        angle_deg=edges.angle_deg,
        sigma_px=wrong,
        sigma_err_px=edges.sigma_err_px,
    )
    assert worst(fit_psf_field(spoilt, COLS, ROWS)) < 0.02


@pytest.mark.slow
def test_photographed_edges_give_the_field_to_one_percent() -> None:
    # 24 photographs of 520 x 390 px, an edge through each; SNR 100.
    psf = psf_of_images(frame_of_edges(noise_dn=28.0))
    assert worst(psf.field) < 0.01
    assert psf.field is not None
    assert psf.field.optical is not None
    assert psf.field.p_value is not None
    assert psf.field.p_value < 1e-10
