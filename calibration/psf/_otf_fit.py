"""Fit of one form of transfer function to the pixels of all edges at once.

Many edges as few: those of about one direction become one, with all that they tell of the lens.
What a transfer function near the truth leaves of an edge's levels, once the edge's own levels,
place, angle and bend are fitted, depends on the lens alone, to first order. Its mean over edges of
one direction, each bin weighted with its inverse variance, is therefore as good as all of them (a
sufficient statistic), and a fit to the means costs the same whatever the number of edges. What the
edges scatter about the mean is kept as a number, so that chi-squared stays that of all levels.

Angles within a group, and the places of the pixels within a bin, are brought to their means with
that transfer function; the second order is left to a last step of the fit over all edges.

Variable projection (Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10, 1973): the levels and the place
of each edge are projected out, and a Levenberg-Marquardt iteration finds the lens.

What the edges show beyond a parametric transfer function: whether there is something, and what. The
correction is a smooth random function of frequency: its coefficients c have the density ``exp(-c' P
c / (2 v))`` with the integral P of squared second derivatives. Its variance v is the one that makes
the edges most likely, which also says how much more likely than none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calibration.psf._otf_forms import EdgeStack, OtfForm, Residuals, StackedBins
from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.psf import correction_roughness

MOST_GROUPS: Final = 32  # 5.6 degrees each, less than what counts as another direction
_GROUP_RAD = np.pi / MOST_GROUPS


def pooled(stack: EdgeStack, form: OtfForm, parameters: FloatArray, left: Residuals) -> EdgeStack:
    """Return one edge for each direction, by parameters near theirs and what these leave."""
    weight = stack.root_weight**2 * left.contrast[:, None] ** 2
    member, normal_rad = _groups(stack.normal_rad, weight.sum(axis=1))
    total = member @ weight
    per_weight = 1.0 / np.where(total > 0, total, np.inf)
    mean = (member @ (stack.root_weight * left.contrast[:, None] * left.values)) * per_weight
    bins = StackedBins(
        centre_px=stack.binned.centre_px,
        levels=np.zeros_like(total),
        weights=total,
        away_px=(member @ (weight * stack.away_px)) * per_weight,
        along=np.zeros_like(total),
        normal_rad=normal_rad,
        blur_px2=np.zeros_like(normal_rad),
        sharpest_px=stack.binned.sharpest_px,
        count=stack.bins,
        pooled_squares=left.squares - float(np.sum(total * mean**2)),
    )
    profiles = EdgeStack(bins).profiles(form.slices(parameters, normal_rad))
    return EdgeStack(replace(bins, levels=profiles + mean))


def _groups(normal_rad: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Which edges each group has, shape ``(groups, edges)`` of 0 and 1, and its mean normal."""
    number, centre = _directions(normal_rad)
    member = (np.arange(centre.size)[:, None] == number).astype(np.float64)
    # A normal is one modulo pi.
    away = (normal_rad - centre[number] + np.pi / 2) % np.pi - np.pi / 2
    return member, centre + (member @ (weight * away)) / (member @ weight)


def _directions(normal_rad: FloatArray) -> tuple[IntArray, FloatArray]:
    """Number of the group that each normal is in, and the angles of the groups' middles."""
    number = np.rint(normal_rad / _GROUP_RAD).astype(np.int64) % MOST_GROUPS
    filled, index = np.unique(number, return_inverse=True)
    return index.astype(np.int64), np.asarray(filled * _GROUP_RAD, dtype=np.float64)


FULL_STEPS = 40
_MAX_DAMPINGS = 8  # tenfold each
_LAST_DAMPINGS = (0.0, 1e-2, 1.0)
LEAST_GAIN = 1e-2  # of chi-squared, in units of its reduced value: a tenth of a standard error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtfFit:
    """A form with the parameters that fit best.

    ``inverse`` is that of the (penalised) normal matrix: the parameters' covariance if edges
    scatter as their noise says. ``freedom`` counts them, a correction's as far as ``penalty``
    leaves them.
    """

    form: OtfForm
    parameters: FloatArray
    residuals: Residuals
    inverse: FloatArray
    freedom: float
    penalty: FloatArray | None = None

    def over(self, stack: EdgeStack) -> "OtfFit":
        """Return the fit with what it leaves of other edges, or of these at other places."""
        slices = self.form.slices(self.parameters, stack.normal_rad)
        with_splines = self.form.harmonics > 0
        return replace(self, residuals=stack.residuals(slices, with_splines=with_splines))

    @property
    def squares(self) -> float:
        """Chi-squared."""
        return self.residuals.squares


def fit_form(
    stack: EdgeStack, form: OtfForm, start: FloatArray, steps: int = FULL_STEPS
) -> OtfFit | None:
    """Fit a form without correction; None where the edges do not determine it."""
    best = form.bounded(start)
    here = stack.residuals(form.slices(best, stack.normal_rad))
    damping = 1e-3
    for _ in range(steps):
        hessian, gradient = _normal_equations(stack, form, best, here)
        trial, there = best, here
        gain = -1.0
        for _ in range(_MAX_DAMPINGS):
            trial = form.bounded(
                best + _bounded_step(hessian, gradient, best - form.least, damping)
            )
            there = stack.residuals(form.slices(trial, stack.normal_rad))
            gain = here.squares - there.squares
            if gain >= 0:
                break
            damping *= 10.0
        if gain < 0:
            break
        best, here = trial, there
        damping *= 0.1
        if gain <= LEAST_GAIN * max(here.squares / stack.bins, 1e-3):
            break
    hessian, gradient = _normal_equations(stack, form, best, here)
    free = _free_parameters(form, best, gradient)
    inverse = _inverse_over(hessian, free)
    if inverse is None:
        return None
    return OtfFit(
        form=form,
        parameters=best,
        residuals=here,
        inverse=inverse,
        freedom=float(best.size),
    )


def settled(stack: EdgeStack, fit: OtfFit) -> OtfFit:
    """Return the fit of edges, by one Gauss-Newton step from that of pooled edges if it gains."""
    form, penalty = fit.form, np.zeros_like(fit.inverse) if fit.penalty is None else fit.penalty
    hessian, gradient = _normal_equations(stack, form, fit.parameters, fit.residuals)
    pull = gradient - penalty @ fit.parameters
    best = fit
    for damping in _LAST_DAMPINGS:
        step = _bounded_step(hessian + penalty, pull, fit.parameters - form.least, damping)
        if float(pull @ step) <= LEAST_GAIN:
            break
        trial = replace(fit, parameters=form.bounded(fit.parameters + step)).over(stack)
        if _penalised(trial, penalty) < _penalised(fit, penalty):
            best = trial
            hessian, gradient = _normal_equations(stack, form, best.parameters, best.residuals)
            break
    free = _free_parameters(form, best.parameters, gradient - penalty @ best.parameters)
    inverse = _inverse_over(hessian + penalty, free)
    if inverse is None:
        return best
    freedom = fit.freedom if fit.penalty is None else float(np.sum(inverse * hessian))
    return replace(best, inverse=inverse, freedom=freedom)


def _penalised(fit: OtfFit, penalty: FloatArray) -> float:
    return fit.squares + float(fit.parameters @ penalty @ fit.parameters)


def expected_gain(stack: EdgeStack, form: OtfForm, fit: OtfFit, start: FloatArray) -> float:
    """How much smaller chi-squared gets in a richer form that starts at a fit, to second order."""
    hessian, gradient = _normal_equations(stack, form, start, fit.residuals)
    step = _bounded_step(hessian, gradient, start - form.least, 1e-9)
    return float(2 * gradient @ step - step @ hessian @ step)


def dispersion(stack: EdgeStack, fit: OtfFit) -> float:
    """Scatter of the edges beyond their pixels' noise, as a factor on the variance.

    Each edge may have a cut-off and a Gaussian of its own: what that gains, over what noise alone
    would gain. It is large where the lens changes from edge to edge (focus, field, rough edges) or
    the form does not hold.
    """
    own = fit.residuals.slopes[:, :, [0, 2]]
    basis, triangle = np.linalg.qr(own)
    size = np.abs(np.diagonal(triangle, axis1=1, axis2=2))
    basis = np.where(size[:, None, :] > 1e-6 * size.max(), basis, 0.0)
    gained = float(np.sum(np.einsum("ebm,eb->em", basis, fit.residuals.values) ** 2))
    by_parameter = fit.residuals.slopes @ fit.form.slice_slopes(fit.parameters, stack.normal_rad)
    shared = basis.transpose(0, 2, 1) @ by_parameter
    used = float(np.einsum("emp,pq,emq->", shared, fit.inverse, shared))
    expected = float(np.sum(basis**2)) - used
    return gained / expected if expected > 1 else 1.0


def _normal_equations(
    stack: EdgeStack, form: OtfForm, parameters: FloatArray, here: Residuals
) -> tuple[FloatArray, FloatArray]:
    """J'J and J'r over all edges."""
    slopes = here.slopes
    by_parameter = form.slice_slopes(parameters, stack.normal_rad)
    gram = slopes.transpose(0, 2, 1) @ slopes
    right = np.einsum("ebt,eb->et", slopes, here.values)
    hessian = np.einsum("etp,eto->po", by_parameter, gram @ by_parameter)
    return np.asarray(hessian), np.asarray(np.einsum("etp,et->p", by_parameter, right))


def _free_parameters(form: OtfForm, parameters: FloatArray, gradient: FloatArray) -> BoolArray:
    """Parameters that are not held at the least that they can be."""
    return np.asarray((parameters > form.least) | (gradient > 0))


def _bounded_step(
    hessian: FloatArray, gradient: FloatArray, room: FloatArray, damping: float
) -> FloatArray:
    """Damped step that goes down by at most ``room``: whatever would go further stops there."""
    free = (room > 0) | (gradient > 0)
    step = np.zeros(room.size)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-30))
    damped = hessian + np.diag(damping * scale**2)
    while free.any():
        asked = (gradient - damped @ np.where(free, 0.0, step))[free] / scale[free]
        scaled = damped[np.ix_(free, free)] / np.outer(scale[free], scale[free])
        step[free] = np.linalg.lstsq(scaled, asked, rcond=1e-12)[0] / scale[free]
        beyond = free & (step < -room)
        if not beyond.any():
            break
        step[beyond] = -room[beyond]
        free &= ~beyond
    return step


def _inverse_over(hessian: FloatArray, free: BoolArray) -> FloatArray | None:
    """Inverse over the free parameters, 0 elsewhere; None where it is not determined."""
    scale = np.sqrt(np.diag(hessian)[free])
    if not np.all(scale > 0):
        return None
    scaled = hessian[np.ix_(free, free)] / np.outer(scale, scale)
    if np.linalg.cond(scaled) > 1e12:
        return None
    inverse = np.zeros_like(hessian)
    inverse[np.ix_(free, free)] = np.linalg.inv(scaled) / np.outer(scale, scale)
    return inverse


_VARIANCES = np.logspace(-14, 2, 81)  # 0.2 apart in the exponent: of the likelihood, less than 0.1
_STEPS = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrectionEvidence:
    """How likely a correction with this many harmonics is, beside a fit without one.

    ``curvatures`` and ``pulls``, shape ``(coefficients,)``, are normal matrix and right side where
    the prior is round, after the fit's own parameters.
    """

    harmonics: int
    curvatures: FloatArray
    pulls: FloatArray

    def log_likelihood(self, scatter: float) -> float:
        """Twice the logarithm of the likelihood over that of no correction, at its best."""
        return float(self._by_variance(scatter).max())

    def variance(self, scatter: float) -> float:
        """The most likely variance v of the prior density."""
        return float(_VARIANCES[np.argmax(self._by_variance(scatter))])

    def _by_variance(self, scatter: float) -> FloatArray:
        """Restricted likelihood of each variance, the parameters integrated over.

        References
        ----------
        G. Wahba, "A comparison of GCV and GML for choosing the smoothing parameter in the
        generalized spline smoothing problem", Ann. Stat. 13 (1985), 1378-1402.
        """
        variance = _VARIANCES[:, None]
        spread = 1 + variance * self.curvatures / scatter
        gained = variance * (self.pulls / scatter) ** 2 / spread
        return np.asarray(np.sum(gained - np.log(spread), axis=1))


def correction_evidence(
    stack: EdgeStack, fit: OtfFit, harmonics: Sequence[int]
) -> list[CorrectionEvidence]:
    """Ask whether corrections with these numbers of harmonics are likely."""
    form = fit.form.with_correction(max(harmonics))
    start = np.concatenate([fit.parameters, np.zeros(form.corrections)])
    here = stack.residuals(form.slices(start, stack.normal_rad), with_splines=True)
    hessian, gradient = _normal_equations(stack, form, start, here)
    count = fit.parameters.size
    # A parameter at its bound must not seem to explain what only a correction can.
    own = np.flatnonzero(_free_parameters(form, start, gradient)[:count])
    found = []
    for number in harmonics:
        one = fit.form.with_correction(number)
        added = np.arange(count, count + one.corrections)
        explained = np.linalg.lstsq(
            hessian[np.ix_(own, own)], hessian[np.ix_(own, added)], rcond=1e-12
        )[0]
        normal = hessian[np.ix_(added, added)] - hessian[np.ix_(added, own)] @ explained
        pull = gradient[added] - explained.T @ gradient[own]
        whiten = np.linalg.inv(np.linalg.cholesky(_roughness(one)[count:, count:]))
        curvature, turn = np.linalg.eigh(whiten @ normal @ whiten.T)
        found.append(
            CorrectionEvidence(
                harmonics=number,
                curvatures=np.maximum(curvature, 0.0),
                pulls=turn.T @ whiten @ pull,
            )
        )
    return found


def fit_correction(
    stack: EdgeStack, fit: OtfFit, evidence: CorrectionEvidence, scatter: float
) -> OtfFit | None:
    """Fit a correction beside the parameters, with the smoothness that is most likely.

    The inverse is the Bayesian covariance, whose bands hold the truth on average over frequencies
    (Nychka, "Bayesian confidence intervals for smoothing splines", J. Am. Stat. Assoc. 83, 1988).
    """
    form = fit.form.with_correction(evidence.harmonics)
    penalty = _roughness(form) * (scatter / evidence.variance(scatter))
    best = np.concatenate([fit.parameters, np.zeros(form.corrections)])
    here = stack.residuals(form.slices(best, stack.normal_rad), with_splines=True)
    hessian, gradient = _normal_equations(stack, form, best, here)
    damping = 1e-6
    for k in range(_STEPS):
        pull = gradient - penalty @ best
        step = _bounded_step(hessian + penalty, pull, best - form.least, damping)
        if k == 0:  # the correction alone is a linear problem: a good start for both
            linear = slice(fit.parameters.size, None)
            step[: fit.parameters.size] = 0.0
            normal = (hessian + penalty)[linear, linear]
            step[linear] = np.linalg.lstsq(normal, pull[linear], rcond=1e-12)[0]
        trial = form.bounded(best + step)
        there = stack.residuals(form.slices(trial, stack.normal_rad), with_splines=True)
        gain = here.squares + best @ penalty @ best
        gain -= there.squares + trial @ penalty @ trial
        if gain < 0:
            damping *= 100.0
            continue
        best, here = trial, there
        hessian, gradient = _normal_equations(stack, form, best, here)
        if gain <= LEAST_GAIN * here.squares / stack.bins:
            break
    free = _free_parameters(form, best, gradient - penalty @ best)
    inverse = _inverse_over(hessian + penalty, free)
    if inverse is None:
        return None
    return OtfFit(
        form=form,
        parameters=best,
        residuals=here,
        inverse=inverse,
        freedom=float(np.sum(inverse * hessian)),
        penalty=penalty,
    )


def _roughness(form: OtfForm) -> FloatArray:
    """Penalty on the correction's coefficients, as a matrix over all parameters."""
    count = len(form.parameter_names)
    penalty = np.zeros((count + form.corrections,) * 2)
    penalty[count:, count:] = np.kron(np.eye(form.harmonics), correction_roughness())
    return penalty
