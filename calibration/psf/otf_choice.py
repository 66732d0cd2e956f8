"""Which form of transfer function the edges ask for: Gaussian, round, elliptic or free."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import log

import numpy as np

from calibration.edges import BinnedEdge
from calibration.psf.otf_fit import OtfFit, dispersion, fit_correction, fit_form
from calibration.psf.otf_forms import AXIAL_GAUSSIAN, ELLIPTIC, GAUSSIAN, ROUND, TWO_ELLIPSES
from calibration.psf.otf_slices import EdgeStack
from simulation.arrays import FloatArray

_SAME_DIRECTION_DEG = 8.0
_WIDEST_GAP_DEG = 100.0  # vertical, horizontal and one diagonal edge between them tell an ellipse
_FEWEST_FOR_CORRECTION = 6  # directions; cos 2a and sin 2a need more than twice 2
_FEWEST_FOR_FOURFOLD = 8
_CORRECTION_REDUCED = 1.02  # of chi-squared: below, no correction can be worth its noise
# Of a criterion: "very strong" evidence (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995).
_MUCH_BETTER = 10.0
_LEAST_VARIANCE_PX2 = 2.5e-3
_START_EDGES, _START_STEPS = 6, 8
# Starts: cut-off period and Gaussian width over the optical width of the edges, squared defocus.
_START_PERIODS = (0.25, 0.5, 1.0, 2.0, 3.5)
_START_WIDTHS = (0.0, 0.7)
_START_DEFOCUS_WAVES2 = (0.0, 0.25, 1.0, 6.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtfChoice:
    """The form chosen and why; ``scale`` multiplies the inverse to give the covariance.

    ``chi2_reduced`` is over the bins of all edges.
    """

    fit: OtfFit
    reason: str
    scale: float
    chi2_reduced: float


def choose_otf(edges: Sequence[BinnedEdge]) -> OtfChoice | None:
    """Fit the forms that the directions of the edges allow, and take the one they ask for.

    Forms without a correction are compared by the Bayesian information criterion (Schwarz,
    "Estimating the dimension of a model", Ann. Stat. 6, 1978), smooth corrections, whose parameters
    are not of equal weight, by Akaike's. Chi-squared counts over the scatter of the edges
    themselves: pixels' noise alone would call every change from edge to edge a new shape of lens.

    Returns
    -------
    OtfChoice or None
        None where the edges are none, or all of one direction.
    """
    directions = distinct_directions_deg([edge.normal_rad for edge in edges])
    if directions.size < 2:
        return None
    stack = EdgeStack(edges)
    variance = _optical_variance(edges)
    is_spread = directions.size > 2 and widest_gap_deg(directions) <= _WIDEST_GAP_DEG
    gaussian = GAUSSIAN if is_spread else AXIAL_GAUSSIAN
    start = np.array([variance, 0.0, variance] if is_spread else [variance, variance])
    simple = fit_form(stack, gaussian, start)
    fits = [simple, fit_form(stack, ROUND, _round_start(edges, variance))]
    if is_spread and fits[1] is not None:
        elliptic = _elliptic(stack, fits[1])
        two = None if elliptic is None else _two_ellipses(stack, simple, fits[1], elliptic)
        base = min((fit for fit in (elliptic, two) if fit), key=_cost, default=None)
        fits += [elliptic, two, *_corrected(stack, base, directions.size)]
    found = [fit for fit in fits if fit is not None]
    return _best(stack, found, _limits(directions, is_spread=is_spread)) if found else None


def distinct_directions_deg(normal_rad: Sequence[float]) -> FloatArray:
    """Directions in [0, 180) that are further apart than a few degrees, in order."""
    distinct: list[float] = []
    for angle in np.sort(np.rad2deg(normal_rad) % 180.0).tolist():
        # Both neighbours on the circle: the last kept one, and the first.
        others = distinct[:1] + distinct[-1:]
        if all(_apart(angle, other) > _SAME_DIRECTION_DEG for other in others):
            distinct.append(angle)
    return np.array(distinct)


def widest_gap_deg(directions_deg: FloatArray) -> float:
    """Largest angle between neighbouring directions."""
    return float(np.max(np.diff(np.append(directions_deg, directions_deg[0] + 180.0))))


def _apart(first_deg: float, second_deg: float) -> float:
    return abs((first_deg - second_deg + 90.0) % 180.0 - 90.0)


def _optical_variance(edges: Sequence[BinnedEdge]) -> float:
    total = float(np.median([edge.sigma_px for edge in edges])) ** 2
    return max(total - 1 / 12, _LEAST_VARIANCE_PX2)


def _round_start(edges: Sequence[BinnedEdge], variance_px2: float) -> FloatArray:
    """Parameters of a round lens from a grid; the best of each defocus is fitted to a few edges.

    Chi-squared has valleys with and without defocus.
    """
    pace = max(len(edges) // _START_EDGES, 1)
    stack = EdgeStack(edges[::pace][:_START_EDGES])
    width = variance_px2**0.5
    best, least = np.array([width, 0.0, variance_px2]), np.inf
    for waves2 in _START_DEFOCUS_WAVES2:
        starts = [
            np.array([period * width, waves2, (share * width) ** 2])
            for period, share in product(_START_PERIODS, _START_WIDTHS)
        ]
        slices = [ROUND.slices(start, stack.normal_rad) for start in starts]
        squares = [stack.residuals(one, with_slopes=False).squares for one in slices]
        fit = fit_form(stack, ROUND, starts[int(np.argmin(squares))], _START_STEPS)
        if fit is not None and fit.squares < least:
            best, least = fit.parameters, fit.squares
    return best


def _elliptic(stack: EdgeStack, round_lens: OtfFit) -> OtfFit | None:
    period, defocus, spread = round_lens.parameters.tolist()
    return fit_form(stack, ELLIPTIC, np.array([period, 0.0, period, defocus, spread]))


def _two_ellipses(
    stack: EdgeStack, gaussian: OtfFit | None, round_lens: OtfFit, elliptic: OtfFit
) -> OtfFit | None:
    """An elliptic pupil with an elliptic Gaussian: either may be the one that is not round."""
    period, defocus, spread = round_lens.parameters.tolist()
    starts = [np.append(elliptic.parameters, [0.0, elliptic.parameters[-1]])]
    if gaussian is not None:
        xx, xy, yy = gaussian.parameters.tolist()
        even = spread - 0.5 * (xx + yy)
        starts.append(np.array([period, 0.0, period, defocus, xx + even, xy, yy + even]))
    fits = [fit_form(stack, TWO_ELLIPSES, start) for start in starts]
    return min((fit for fit in fits if fit), key=lambda fit: fit.squares, default=None)


def _cost(fit: OtfFit) -> float:
    """Akaike's criterion."""
    return fit.squares + 2 * fit.freedom


def _corrected(stack: EdgeStack, base: OtfFit | None, directions: int) -> list[OtfFit | None]:
    """The free form, where there are directions enough and the misfit leaves room for it."""
    if base is None or directions < _FEWEST_FOR_CORRECTION:
        return []
    if base.squares <= _CORRECTION_REDUCED * (stack.bins - base.freedom):
        return []
    harmonics = (1, 3) if directions < _FEWEST_FOR_FOURFOLD else (1, 3, 5)
    return [fit_correction(stack, base, count) for count in harmonics]


def _limits(directions_deg: FloatArray, *, is_spread: bool) -> str:
    """What the directions do not allow, for the reason."""
    if is_spread:
        return ""
    return f"; {directions_deg.size} directions do not tell an elliptic one"


def _best(stack: EdgeStack, fits: Sequence[OtfFit], limits: str) -> OtfChoice:
    """The form that the criteria choose, simplest first."""
    smooth = [fit for fit in fits if fit.form.harmonics]
    plain = [fit for fit in fits if not fit.form.harmonics]
    richest = min(smooth, key=_cost, default=plain[-1])
    scatter = max(dispersion(stack, richest), 1.0)

    def criterion(fit: OtfFit, cost: float) -> float:
        return fit.squares / scatter + cost * fit.freedom

    best = plain[0]
    for fit in plain[1:]:
        if criterion(fit, log(stack.bins)) < criterion(best, log(stack.bins)) - _MUCH_BETTER:
            best = fit
    if smooth and criterion(richest, 2.0) < criterion(best, 2.0) - _MUCH_BETTER:
        best = richest
    compared = ", ".join(
        f"{fit.form.name} {fit.squares / scatter:.0f} ({fit.freedom:.0f})" for fit in fits
    )
    reduced = best.squares / max(stack.bins - best.freedom, 1.0)
    return OtfChoice(
        fit=best,
        reason=f"chi2 over the edges' scatter (parameters): {compared}{limits}",
        scale=max(dispersion(stack, best), reduced, 1.0),
        chi2_reduced=reduced,
    )
