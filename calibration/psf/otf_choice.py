"""Which form of transfer function the edges ask for: a Gaussian, round, elliptic or free."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import log

import numpy as np

from calibration.edges import BinnedEdge, orientation_of
from calibration.psf.otf_correction import (
    CorrectionEvidence,
    correction_evidence,
    fit_correction,
)
from calibration.psf.otf_fit import (
    FULL_STEPS,
    OtfFit,
    dispersion,
    expected_gain,
    fit_form,
    settled,
)
from calibration.psf.otf_forms import (
    ASTIGMATIC,
    AXIAL,
    AXIAL_GAUSSIAN,
    AXIAL_TOTAL_GAUSSIAN,
    ELLIPTIC,
    GAUSSIAN,
    ROUND,
    TOTAL_GAUSSIAN,
    TWO_ELLIPSES,
    OtfForm,
)
from calibration.psf.otf_pool import MOST_GROUPS, pooled
from calibration.psf.otf_slices import EdgeStack, StackedBins
from simulation.arrays import FloatArray

_SAME_DIRECTION_DEG = 8.0
_WIDEST_GAP_DEG = 100.0  # vertical, horizontal and one diagonal edge between them tell an ellipse
_FEWEST_FOR_CORRECTION = 6  # directions; cos 2a and sin 2a need more than twice 2
_FEWEST_FOR_FOURFOLD = 8
# Of a criterion, and of twice the logarithm of a likelihood ratio: "very strong" and "strong"
# evidence (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995).
_MUCH_BETTER, _BETTER = 10.0, 6.0
_NOT_WORTH_A_FIT = 8.0  # expected of chi-squared: two parameters must gain 26 to be taken
_FEW_STEPS = 2
# JPEG photographs of chessboards stand at 1200: their edges differ by far more than their noise;
# what they share of a shape cannot be told from that.
_TOO_SCATTERED = 10.0
_SCATTERED = 1.5  # below, the correction stays as it is for the noise alone
_LEAST_VARIANCE_PX2 = 2.5e-3
_START_EDGES, _START_STEPS = 6, 3
_VALLEYS, _MORE_STEPS = 2, 5  # the best two of the starts go on
# Starts: cut-off period and Gaussian width over the optical width of the edges, squared defocus.
_START_PERIODS = (0.25, 0.5, 1.0, 2.0, 3.5)
_START_WIDTHS = (0.0, 0.7)
_START_DEFOCUS_WAVES2 = (0.0, 0.25, 1.0, 6.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtfChoice:
    """The form chosen and why; ``scale`` multiplies the inverse to give the covariance.

    ``chi2_reduced`` is over the bins of all edges. Without ``knows_turn`` the directions of the
    edges leave open how the lens is turned, and every form is upright.
    """

    fit: OtfFit
    reason: str
    scale: float
    chi2_reduced: float
    knows_turn: bool


def choose_otf(edges: Sequence[BinnedEdge], *, knows_correlation: bool = True) -> OtfChoice | None:
    """Fit the forms that the directions of the edges allow, and take the one they ask for.

    Forms without a correction are compared by the Bayesian information criterion (Schwarz,
    "Estimating the dimension of a model", Ann. Stat. 6, 1978), smooth corrections, whose parameters
    are not of equal weight, by Akaike's. Chi-squared counts over the scatter of the edges
    themselves: pixels' noise alone would call every change from edge to edge a new shape of lens.

    Parameters
    ----------
    edges
        The edges.
    knows_correlation
        False where their widths have left rho undetermined. Then only upright lenses are fitted,
        whose ellipses lie along the axes: directions close to each other would decide how one is
        turned, and between them a lens changes over its field as well.

    Returns
    -------
    OtfChoice or None
        None where the edges are none, or all of one direction, or two directions that are not those
        of vertical and horizontal edges.
    """
    directions = distinct_directions_deg([edge.normal_rad for edge in edges])
    if directions.size < 2:
        return None
    has_third = directions.size > 2 and widest_gap_deg(directions) <= _WIDEST_GAP_DEG
    is_spread = has_third and knows_correlation
    named = {orientation_of(angle + 90.0) for angle in directions.tolist()}
    if not is_spread and not {"vertical", "horizontal"} <= named:
        return None
    every = EdgeStack(StackedBins.of(edges))
    stack, plain = _uncorrected_fits(every, _optical_variance(edges), is_spread=is_spread)
    if not plain:
        return None
    told_by = "widths that leave rho open" if has_third else f"{directions.size} directions"
    limits = "" if is_spread else f"; {told_by} do not tell how it is turned: taken as upright"
    bases = [fit for fit in plain if fit.form in (ELLIPTIC, ASTIGMATIC, TWO_ELLIPSES)]
    asked: list[CorrectionEvidence] = []
    base = min(bases, key=_cost, default=plain[0])
    if bases and directions.size >= _FEWEST_FOR_CORRECTION:
        harmonics = (1, 3) if directions.size < _FEWEST_FOR_FOURFOLD else (1, 3, 5)
        asked = correction_evidence(stack, base, harmonics)
    correction = _Correction(stack=stack, base=base, asked=asked)
    choice = _best(every, plain, correction)
    return replace(choice, reason=choice.reason + limits, knows_turn=is_spread)


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
    total = float(np.median([edge.sigma_px**2 - edge.blur_px2 for edge in edges]))
    return max(total - 1 / 12, _LEAST_VARIANCE_PX2)


def _round_start(bins: StackedBins, variance_px2: float) -> FloatArray:
    """Parameters of a round lens from a grid; the best of each defocus race on a few edges.

    Chi-squared has valleys with and without defocus.
    """
    pace = max(len(bins.levels) // _START_EDGES, 1)
    stack = EdgeStack(bins.some(slice(None, pace * _START_EDGES, pace)))
    width = variance_px2**0.5
    found = []
    for waves2 in _START_DEFOCUS_WAVES2:
        starts = [
            np.array([period * width, waves2, (share * width) ** 2])
            for period, share in product(_START_PERIODS, _START_WIDTHS)
        ]
        slices = [ROUND.slices(start, stack.normal_rad) for start in starts]
        squares = [stack.residuals(one, with_slopes=False).squares for one in slices]
        found.append(fit_form(stack, ROUND, starts[int(np.argmin(squares))], _START_STEPS))
    ahead = sorted((fit for fit in found if fit is not None), key=lambda fit: fit.squares)
    more = [fit_form(stack, ROUND, fit.parameters, _MORE_STEPS) for fit in ahead[:_VALLEYS]]
    best = min((fit for fit in more if fit), key=lambda fit: fit.squares, default=None)
    return np.array([width, 0.0, variance_px2]) if best is None else best.parameters


def _uncorrected_fits(
    every: EdgeStack, variance_px2: float, *, is_spread: bool
) -> tuple[EdgeStack, list[OtfFit]]:
    """Fits of the forms without a correction, simplest first, and the edges that they are of.

    Those are the edges themselves; many edges are pooled by their direction, about a Gaussian at
    first and then about the best of the first fits. Whatever these show of the places of the edges
    is put right before the last ones.
    """
    is_many = len(every.normal_rad) > MOST_GROUPS
    stack = every
    if is_many:
        guess = np.full(2, variance_px2)
        left = every.left_by(AXIAL_GAUSSIAN.slices(guess, every.normal_rad))
        stack = pooled(every, AXIAL_GAUSSIAN, guess, left)
    start = _round_start(stack.binned, variance_px2)
    fits = _first_fits(stack, variance_px2, start, is_spread=is_spread)
    if not fits:
        return stack, []
    best = min(fits, key=_cost)
    left = best.residuals
    if is_many:
        left = every.left_by(best.form.slices(best.parameters, every.normal_rad))
    is_moved = every.aligned(left.shift_px)
    if is_many:
        stack = pooled(every, best.form, best.parameters, left)
    if is_moved or is_many:
        again = [fit_form(stack, fit.form, fit.parameters) for fit in fits]
        fits = [fit for fit in again if fit is not None]
    both = _two_ellipses(stack, fits)
    return stack, fits if both is None else [*fits, both]


def _first_fits(
    stack: EdgeStack, variance_px2: float, round_start: FloatArray, *, is_spread: bool
) -> list[OtfFit]:
    """Fits of the simpler forms that the directions allow."""
    lens, total = (
        (GAUSSIAN, TOTAL_GAUSSIAN) if is_spread else (AXIAL_GAUSSIAN, AXIAL_TOTAL_GAUSSIAN)
    )
    start = variance_px2 * np.array([1.0, 0.0, 1.0] if is_spread else [1.0, 1.0])
    pixel = np.array([1.0, 0.0, 1.0] if is_spread else [1.0, 1.0]) / 12
    round_lens = fit_form(stack, ROUND, round_start)
    fits = [fit_form(stack, lens, start), fit_form(stack, total, start + pixel), round_lens]
    if round_lens is not None:
        richer = (ELLIPTIC, ASTIGMATIC) if is_spread else AXIAL
        fits += [_gone_on(stack, form, round_lens) for form in richer]
    return [fit for fit in fits if fit is not None]


def _gone_on(stack: EdgeStack, form: OtfForm, simpler: OtfFit) -> OtfFit | None:
    """A fit of a richer form from the lens of a simpler one; a few steps where it gains little."""
    start = form.nearest(simpler.form.elements @ simpler.parameters)
    is_worth = expected_gain(stack, form, simpler, start) > _NOT_WORTH_A_FIT
    return fit_form(stack, form, start, FULL_STEPS if is_worth else _FEW_STEPS)


def _two_ellipses(stack: EdgeStack, fits: Sequence[OtfFit]) -> OtfFit | None:
    """An elliptic pupil with an elliptic Gaussian: either may be the one that is not round.

    None where they gain nothing, or an elliptic pupil is no better than a total Gaussian.
    """
    known = {fit.form: fit for fit in fits}
    elliptic, total = known.get(ELLIPTIC), known.get(TOTAL_GAUSSIAN)
    if elliptic is None or (total is not None and elliptic.squares >= total.squares):
        return None
    start = np.append(elliptic.parameters, [0.0, elliptic.parameters[-1]])
    if expected_gain(stack, TWO_ELLIPSES, elliptic, start) <= _NOT_WORTH_A_FIT:
        return None
    starts = [start]
    if GAUSSIAN in known and ROUND in known:
        period, defocus, spread = known[ROUND].parameters.tolist()
        xx, xy, yy = known[GAUSSIAN].parameters.tolist()
        even = spread - 0.5 * (xx + yy)
        starts.append(np.array([period, 0.0, period, defocus, xx + even, xy, yy + even]))
    both = [fit_form(stack, TWO_ELLIPSES, start) for start in starts]
    return min((fit for fit in both if fit), key=lambda fit: fit.squares, default=None)


def _cost(fit: OtfFit) -> float:
    """Akaike's criterion."""
    return fit.squares + 2 * fit.freedom


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Correction:
    """The fit that a correction would go on from, and how likely corrections to it are."""

    stack: EdgeStack
    base: OtfFit
    asked: Sequence[CorrectionEvidence]

    def likely(self, best: OtfFit, scatter: float) -> CorrectionEvidence | None:
        """The correction to take instead of the best fit without one; None for none.

        Of corrections that are about as likely, the richest: its band holds more lenses.
        """
        found = [one.log_likelihood(scatter) for one in self.asked]
        ahead = (_cost(self.base) - _cost(best)) / scatter + _BETTER
        if not found or max(found) < ahead:
            return None
        close = max(max(found) - _MUCH_BETTER, ahead)
        return max(
            (one for one, value in zip(self.asked, found, strict=True) if value >= close),
            key=lambda one: one.harmonics,
        )

    def fitted(self, best: OtfFit, scatter: float) -> OtfFit | None:
        """The fit with the correction to take instead of the best one; None for none."""
        evidence = self.likely(best, scatter)
        if evidence is None:
            return None
        return fit_correction(self.stack, self.base, evidence, scatter)

    def fitted_over_scatter(self, best: OtfFit, scatter: float) -> OtfFit | None:
        """A correction where edges differ from each other: of what they share, if that tells.

        Akaike's criterion must ask for it as well.
        """
        corrected = None if scatter > _TOO_SCATTERED else self.fitted(best, scatter)
        if corrected is None:
            return None
        gained = (best.squares - corrected.squares) / scatter
        asked = 2 * (corrected.freedom - best.freedom) + _MUCH_BETTER
        return corrected if gained >= asked else None


def _best(every: EdgeStack, plain: Sequence[OtfFit], correction: _Correction) -> OtfChoice:
    """The form that the criteria choose, simplest first, settled over all edges."""
    richest = min(plain, key=_cost)
    corrected = correction.fitted(richest, 1.0)
    # Where the lens has no form of these, only a correction tells the scatter of the edges.
    telling = corrected or richest
    over_every = telling.over(every)
    scatter = max(dispersion(every, over_every), 1.0)

    def criterion(fit: OtfFit) -> float:
        return fit.squares / scatter + log(every.bins) * fit.freedom

    best = plain[0]
    for fit in plain[1:]:
        # Cameras have pixels; but a total Gaussian has no more parameters than one over them.
        margin = _MUCH_BETTER if fit.form.has_pixel else _BETTER
        if criterion(fit) < criterion(best) - margin:
            best = fit
    compared = [*plain, corrected] if corrected else plain
    if corrected is not None:
        if scatter > _SCATTERED:
            corrected = correction.fitted_over_scatter(best, scatter)
        best = corrected or best
    reason = ", ".join(
        f"{fit.form.label} {fit.squares / scatter:.0f} ({fit.freedom:.0f})" for fit in compared
    )
    if correction.stack is not every:
        best = settled(every, over_every if best is telling else best.over(every))
    reduced = best.squares / max(every.bins - best.freedom, 1.0)
    return OtfChoice(
        fit=best,
        reason=f"chi2 over the edges' scatter (parameters): {reason}",
        scale=max(dispersion(every, best), reduced, 1.0),
        chi2_reduced=reduced,
        knows_turn=True,
    )
