"""Which form is chosen for which lens, and the fit's derivatives."""

import numpy as np
import pytest

from calibration.edges import BinnedEdge, edges_of_image
from calibration.psf._otf_forms import ELLIPTIC, EdgeStack, StackedBins
from calibration.psf._transfer_2d import _choose_otf, _distinct_directions_deg, _widest_gap_deg
from simulation.arrays import FloatArray
from tests.calibration.known import known
from tests.calibration.lens_edges import AstigmaticLens, Lens, edge_photographs, pupil_transfer

EIGHT_DEG = tuple(5.0 + 22.5 * k for k in range(8))
LENGTH_PX = 90.0


def binned(lens: Lens, normals_deg: tuple[float, ...], snr: float = 200) -> list[BinnedEdge]:
    return [
        edge.binned
        for source in edge_photographs(lens, normals_deg, snr, 7, LENGTH_PX)
        for edge in edges_of_image(source)
        if edge.binned is not None
    ]


class MovedLens(Lens):
    """A round lens that moved by 1.5 px at 30 degrees during the exposure: no form has that."""

    def otf(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        pupil = pupil_transfer(0.37 * np.hypot(fx, fy), 0.0)
        moved = np.sinc(1.5 * (fx * np.cos(np.pi / 6) + fy * np.sin(np.pi / 6)))
        return np.asarray(pupil * moved * np.sinc(fx) * np.sinc(fy))


class TotalGaussian(Lens):
    """A Gaussian of lens and pixel in one, as rendered edges have."""

    def otf(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-2 * (np.pi * self.sigma_px) ** 2 * (fx * fx + fy * fy)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lens", "form"),
    [
        (TotalGaussian(0.0, 0.0, sigma_px=0.5), "total-gaussian"),
        (TotalGaussian(0.0, 0.0, sigma_px=0.7), "total-gaussian"),
        (Lens(0.0, 0.0, sigma_px=0.5), "gaussian"),
        (Lens(0.0, 0.0, sigma_px=1.2), "gaussian"),
        (Lens(0.37, 0.37), "round"),
        (Lens(0.19, 0.19, waves=1.0), "round"),
        (Lens(0.55, 0.35, turn_deg=30.0), "elliptic"),
        (MovedLens(0.37, 0.37), "free"),
    ],
)
def test_the_form_is_the_simplest_that_the_lens_asks_for(lens: Lens, form: str) -> None:
    choice = known(_choose_otf(binned(lens, EIGHT_DEG, snr=500)))
    assert choice.fit.form.name == form
    # The noise within the bins explains what is left, and no form is far off.
    assert choice.chi2_reduced < 1.2


def test_one_direction_determines_no_transfer_over_both_axes() -> None:
    assert _choose_otf(binned(Lens(0.37, 0.37), (4.0, 9.0))) is None


@pytest.mark.parametrize(
    ("lens", "label"),
    [
        (Lens(0.0, 0.0, sigma_px=0.6), "gaussian"),
        (Lens(0.5, 0.5), "round"),
        (Lens(0.6, 0.35), "elliptic in cut-off"),
        (AstigmaticLens(0.27, 0.27, x_waves=0.8, y_waves=0.4), "elliptic in defocus"),
    ],
)
def test_two_directions_give_an_upright_lens(lens: Lens, label: str) -> None:
    choice = known(_choose_otf(binned(lens, (4.0, 94.0))))
    assert choice.fit.form.label == label
    assert not choice.knows_turn
    assert "2 directions do not show its orientation" in choice.reason


def test_two_directions_that_are_not_of_the_axes_give_no_transfer() -> None:
    for normals in ((4.0, 49.0), (30.0, 120.0)):
        assert _choose_otf(binned(Lens(0.5, 0.5), normals)) is None


def test_widths_that_leave_the_correlation_open_give_no_form_that_is_turned() -> None:
    lens = Lens(0.6, 0.4, turn_deg=30.0)
    turned = known(_choose_otf(binned(lens, EIGHT_DEG)))
    choice = known(_choose_otf(binned(lens, EIGHT_DEG), knows_correlation=False))
    assert any("xy" in name for name in turned.fit.form.names)
    assert not any("xy" in name for name in choice.fit.form.names)
    assert "leave rho open" in choice.reason


@pytest.mark.slow
def test_a_vertical_a_horizontal_and_a_diagonal_edge_tell_a_turned_gaussian() -> None:
    # As the sum of two Gaussians' variances: 0.6 px across, 0.4 px along 30 degrees.
    class Turned(Lens):
        def otf(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
            u = fx * np.cos(np.pi / 6) + fy * np.sin(np.pi / 6)
            v = fy * np.cos(np.pi / 6) - fx * np.sin(np.pi / 6)
            gauss = np.exp(-2 * np.pi**2 * (0.36 * u * u + 0.16 * v * v))
            return np.asarray(gauss * np.sinc(fx) * np.sinc(fy))

    choice = known(_choose_otf(binned(Turned(0.0, 0.0), (4.0, 49.0, 94.0))))
    assert choice.fit.form.name == "gaussian"
    # S xy is (0.36 - 0.16) cos 30 sin 30 = 0.087.
    assert choice.fit.parameters.tolist() == pytest.approx([0.31, 0.0866, 0.21], abs=0.006)


@pytest.mark.slow
def test_edges_that_differ_widen_the_covariance_and_do_not_change_the_form() -> None:
    # Focus drifts from edge to edge by 5 % of the width, at an SNR of 500.
    sigmas = 0.6 * (1 + 0.05 * np.array([1, -1, 0.5, -0.7, 0.9, -0.2, -1, 0.5]))
    edges = [
        binned(Lens(0.0, 0.0, sigma_px=float(sigma)), (normal,), snr=500)[0]
        for sigma, normal in zip(sigmas, EIGHT_DEG, strict=True)
    ]
    choice = known(_choose_otf(edges))
    assert choice.fit.form.name == "gaussian"
    err = np.sqrt(choice.scale * choice.fit.inverse[0, 0])
    # 8 variances scatter by 10 %; three parameters share them: xx to about 10 % / sqrt(8 / 2.4).
    assert 0.02 < err / 0.36 < 0.12


def test_the_residuals_slopes_are_differences_of_the_levels() -> None:
    lens = Lens(0.55, 0.35, turn_deg=30.0, waves=0.5, sigma_px=0.3)
    stack = EdgeStack(StackedBins.of(binned(lens, EIGHT_DEG)))
    # The lens itself: B xy is (0.55 - 0.35) cos 30 sin 30.
    parameters = np.array([0.5, 0.0866, 0.4, 0.25, 0.09])
    here = stack.residuals(ELLIPTIC.slices(parameters, stack.normal_rad))
    by_parameter = ELLIPTIC.slice_slopes(parameters, stack.normal_rad)
    for k in range(parameters.size):
        step = np.zeros(parameters.size)
        step[k] = 1e-5
        above = stack.residuals(ELLIPTIC.slices(parameters + step, stack.normal_rad))
        below = stack.residuals(ELLIPTIC.slices(parameters - step, stack.normal_rad))
        change = (above.values - below.values) / 2e-5
        slopes = (here.slopes @ by_parameter)[:, :, k]
        # Kaufman's slopes leave out how the projection turns, which is nothing without a misfit.
        assert np.abs(change + slopes).max() < 0.05 * np.abs(slopes).max()


def test_directions_on_both_sides_of_0_are_one() -> None:
    turns = np.deg2rad([179.0, 1.0, 45.0, 46.0, 91.0])
    directions = _distinct_directions_deg(turns.tolist())
    assert directions.tolist() == pytest.approx([1.0, 45.0, 91.0])
    assert _widest_gap_deg(directions) == pytest.approx(90.0)


def test_one_gaussian_for_lens_and_pixel_keeps_its_width_from_two_directions() -> None:
    choice = known(_choose_otf(binned(TotalGaussian(0.0, 0.0, sigma_px=0.6), (4.0, 94.0))))
    assert choice.fit.form.name == "total-gaussian"
    assert choice.fit.parameters.tolist() == pytest.approx([0.36, 0.36], rel=0.005)


@pytest.mark.parametrize(
    ("off_deg", "misfit"),
    # At 1 degree a misfit of 1 % of the contrast stays in some bins of 90 px of edge.
    [(0.0, 1.4), (0.3, 1.4), (1.0, 6.0)],
)
def test_edges_along_the_rows_and_columns_measure_a_sharp_lens(
    off_deg: float, misfit: float
) -> None:
    # A Gaussian fitted to f/2.8 finds the angle and the bend of such edges up to 0.06 px wrong.
    lens = Lens(0.186, 0.186)
    choice = known(_choose_otf(binned(lens, (off_deg, 90.0 + off_deg), snr=500)))
    assert choice.fit.form.name == "round"
    assert choice.chi2_reduced < misfit  # at 0.3 degrees 16 with the places of the Gaussian
    freq = np.linspace(0.0, 0.5, 11)
    found = choice.fit.form.lens(choice.fit.parameters)(freq, 0 * freq) * np.sinc(freq)
    # Exactly along them an edge has samples a whole pixel apart: 0.0013.
    assert np.abs(found - lens.otf(freq, 0 * freq)).max() < 0.003
