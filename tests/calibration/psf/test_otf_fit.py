"""Edges pooled by direction tell of the lens what they tell one by one."""

import numpy as np
import pytest

from calibration.edges import BinnedEdge, bin_centres_px
from calibration.psf._otf_fit import OtfFit, fit_form, pooled, settled
from calibration.psf._otf_forms import AXIAL_GAUSSIAN, ELLIPTIC, ROUND, EdgeStack, StackedBins
from calibration.psf._transfer_2d import _choose_otf
from simulation.arrays import FloatArray
from tests.calibration.draws import rms_range
from tests.calibration.known import known
from tests.calibration.lens_edges import Lens, profile

LENS = Lens(0.55, 0.35, turn_deg=30.0)
# B of the lens: 0.45 +- 0.1 about its axes, turned by 30 degrees; no defocus, no Gaussian.
TRUTH = np.array([0.5, 0.0866, 0.4, 0.0, 0.0])
TWELVE_DEG = tuple(4.0 + 15.0 * k for k in range(12))
NOISE = 0.004  # of a bin: 25 pixels at an SNR of 50


def edges_of(
    lens: Lens, normals_deg: FloatArray, rng: np.random.Generator, noise: float = NOISE
) -> list[BinnedEdge]:
    """Bins of edges in closed form: each with levels, a place and pixels in its bins of its own.

    A profile is made for every twelfth of a turn, so the normals are of those directions.
    """
    index = np.arange(-56, 57)  # to 8 px on either side
    out = []
    for normal_deg in normals_deg.tolist():
        away = rng.uniform(-1 / 64, 1 / 64, index.size)
        shift = rng.normal() * 0.003
        at = bin_centres_px(index) + away + shift
        levels = rng.normal() * 0.002 + (1 + rng.normal() * 0.002) * profile(lens, normal_deg)(at)
        out.append(
            BinnedEdge(
                bin_index=index,
                away_px=away,
                along_px=rng.uniform(-3, 3, index.size),
                levels=levels + rng.normal(size=index.size) * noise,
                weights=np.full(index.size, noise**-2),
                normal_rad=float(np.deg2rad(normal_deg)),
                sigma_px=0.5,
            )
        )
    return out


def normals(count: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(rng.permutation(np.resize(TWELVE_DEG, count)), dtype=np.float64)


def fits(edges: list[BinnedEdge]) -> tuple[OtfFit, OtfFit]:
    """The fit of all edges, and that of edges pooled twice, settled."""
    every = EdgeStack(StackedBins.of(edges))
    guess = np.full(2, 0.25)
    first = every.left_by(AXIAL_GAUSSIAN.slices(guess, every.normal_rad))
    few = known(
        fit_form(pooled(every, AXIAL_GAUSSIAN, guess, first), ROUND, np.array([0.4, 0.0, 0.01]))
    )
    left = every.left_by(ROUND.slices(few.parameters, every.normal_rad))
    means = known(fit_form(pooled(every, ROUND, few.parameters, left), ELLIPTIC, TRUTH))
    whole = known(fit_form(every, ELLIPTIC, TRUTH))
    return whole, settled(every, means.over(every))


def test_the_fit_of_pooled_edges_is_that_of_all() -> None:
    rng = np.random.default_rng(4)
    whole, means = fits(edges_of(LENS, normals(240, rng), rng))
    err = np.sqrt(np.diag(whole.inverse))
    free = err > 0
    # A fit ends where a step would gain 0.01 of chi-squared: a tenth of a standard error.
    assert np.abs((means.parameters - whole.parameters)[free] / err[free]).max() < 0.1
    assert np.sqrt(np.diag(means.inverse))[free] == pytest.approx(err[free], rel=0.01)
    assert means.squares == pytest.approx(whole.squares, abs=0.05)


def test_chi_squared_of_pooled_edges_is_that_of_all_levels() -> None:
    rng = np.random.default_rng(5)
    edges = edges_of(LENS, normals(96, rng), rng)
    every = EdgeStack(StackedBins.of(edges))
    left = every.left_by(ELLIPTIC.slices(TRUTH, every.normal_rad))
    means = pooled(every, ELLIPTIC, TRUTH, left)
    assert means.shape[0] == len(TWELVE_DEG)
    assert means.bins == every.bins == sum(edge.levels.size for edge in edges)
    there = means.left_by(ELLIPTIC.slices(TRUTH, means.normal_rad))
    # Of each group, two levels and a place are fitted once more: 36 numbers of noise, shared by 8.
    assert there.squares == pytest.approx(left.squares, abs=36 / 8 * 3)
    # A lens 5 % off is as much worse for the means as for the edges.
    off = TRUTH * 1.05
    worse = every.left_by(ELLIPTIC.slices(off, every.normal_rad)).squares - left.squares
    worse_means = means.left_by(ELLIPTIC.slices(off, means.normal_rad)).squares - there.squares
    assert worse > 500
    # The angles and bends, two of about 20 bins on the edge, are not fitted again to the means.
    assert worse_means == pytest.approx(worse, rel=0.1)


def test_normals_half_a_turn_apart_are_pooled() -> None:
    rng = np.random.default_rng(6)
    edges = edges_of(LENS, np.array([4.0] * 4), rng)
    turned = [
        BinnedEdge(
            bin_index=edge.bin_index,
            away_px=edge.away_px,
            along_px=edge.along_px,
            levels=edge.levels,
            weights=edge.weights,
            normal_rad=edge.normal_rad - np.pi * (k % 2),
            sigma_px=edge.sigma_px,
        )
        for k, edge in enumerate(edges)
    ]
    every = EdgeStack(StackedBins.of(turned))
    left = every.left_by(ELLIPTIC.slices(TRUTH, every.normal_rad))
    means = pooled(every, ELLIPTIC, TRUTH, left)
    assert np.rad2deg(means.normal_rad) % 180 == pytest.approx([4.0])


@pytest.mark.slow
def test_the_95_percent_band_of_many_edges_holds_the_truth() -> None:
    freq = np.array([0.125, 0.25, 0.4])
    angle = np.deg2rad(np.arange(0.0, 180.0, 15.0))[:, None]
    fx, fy = freq * np.cos(angle), freq * np.sin(angle)
    truth = LENS.otf(fx, fy) / (np.sinc(fx) * np.sinc(fy))
    errors = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        choice = known(_choose_otf(edges_of(LENS, normals(120, rng), rng, noise=0.02)))
        # Five of an edge's 113 levels go into its own numbers; 13,560 levels scatter by 0.012.
        assert choice.chi2_reduced == pytest.approx(108 / 113, abs=0.04)
        found = choice.fit.form.lens(choice.fit.parameters)(fx, fy)
        slopes = choice.fit.form.otf_slopes(choice.fit.parameters, fx.ravel(), fy.ravel())
        covariance = choice.scale * choice.fit.inverse
        err = np.sqrt(np.sum((slopes @ covariance) * slopes, axis=1)).reshape(fx.shape)
        errors.append((found - truth) / err)
    # The 36 of one calibration come of five parameters: their mean square scatters like that of 3.
    assert np.sqrt(np.mean(np.square(errors))) < rms_range(8 * 3)[1]
