"""Fit of one form of transfer function to the pixels of all edges at once.

Variable projection (Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10, 1973): the levels and the place
of each edge are projected out, and a Levenberg-Marquardt iteration finds the lens.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.psf.otf_forms import OtfForm
from calibration.psf.otf_slices import EdgeStack, Residuals
from simulation.arrays import BoolArray, FloatArray

FULL_STEPS = 40
_MAX_DAMPINGS = 8  # tenfold each
_LAST_DAMPINGS = (0.0, 1e-2, 1.0)
LEAST_GAIN = 1e-2  # of chi-squared, in units of its reduced value: a tenth of a standard error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtfFit:
    """A form with the parameters that fit best.

    ``inverse`` is the inverse of the (penalised) normal matrix: the covariance of the parameters if
    the edges scatter as their pixels' noise says. ``freedom`` counts the parameters, those of a
    correction as far as its smoothness leaves them free; ``penalty`` is the matrix of that.
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
        hessian, gradient = normal_equations(stack, form, best, here)
        trial, there = best, here
        gain = -1.0
        for _ in range(_MAX_DAMPINGS):
            trial = form.bounded(best + bounded_step(hessian, gradient, best - form.least, damping))
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
    hessian, gradient = normal_equations(stack, form, best, here)
    free = free_parameters(form, best, gradient)
    inverse = inverse_over(hessian, free)
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
    """Return the fit of edges, from one of pooled edges with what it leaves of the edges.

    From so near, a step of Gauss and Newton is the minimum to second order; one that gains less
    than the fits look for is not taken.
    """
    form, penalty = fit.form, np.zeros_like(fit.inverse) if fit.penalty is None else fit.penalty
    hessian, gradient = normal_equations(stack, form, fit.parameters, fit.residuals)
    pull = gradient - penalty @ fit.parameters
    best = fit
    for damping in _LAST_DAMPINGS:
        step = bounded_step(hessian + penalty, pull, fit.parameters - form.least, damping)
        if float(pull @ step) <= LEAST_GAIN:
            break
        trial = replace(fit, parameters=form.bounded(fit.parameters + step)).over(stack)
        if _penalised(trial, penalty) < _penalised(fit, penalty):
            best = trial
            hessian, gradient = normal_equations(stack, form, best.parameters, best.residuals)
            break
    free = free_parameters(form, best.parameters, gradient - penalty @ best.parameters)
    inverse = inverse_over(hessian + penalty, free)
    if inverse is None:
        return best
    freedom = fit.freedom if fit.penalty is None else float(np.sum(inverse * hessian))
    return replace(best, inverse=inverse, freedom=freedom)


def _penalised(fit: OtfFit, penalty: FloatArray) -> float:
    return fit.squares + float(fit.parameters @ penalty @ fit.parameters)


def expected_gain(stack: EdgeStack, form: OtfForm, fit: OtfFit, start: FloatArray) -> float:
    """How much smaller chi-squared gets if a fit goes on in a richer form, to second order.

    ``start`` are the parameters of ``form`` that are the lens of ``fit``.
    """
    hessian, gradient = normal_equations(stack, form, start, fit.residuals)
    step = bounded_step(hessian, gradient, start - form.least, 1e-9)
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


def normal_equations(
    stack: EdgeStack, form: OtfForm, parameters: FloatArray, here: Residuals
) -> tuple[FloatArray, FloatArray]:
    """J'J and J'r over all edges."""
    slopes = here.slopes
    by_parameter = form.slice_slopes(parameters, stack.normal_rad)
    gram = slopes.transpose(0, 2, 1) @ slopes
    right = np.einsum("ebt,eb->et", slopes, here.values)
    hessian = np.einsum("etp,eto->po", by_parameter, gram @ by_parameter)
    return np.asarray(hessian), np.asarray(np.einsum("etp,et->p", by_parameter, right))


def free_parameters(form: OtfForm, parameters: FloatArray, gradient: FloatArray) -> BoolArray:
    """Parameters that are not held at the least that they can be."""
    return np.asarray((parameters > form.least) | (gradient > 0))


def bounded_step(
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


def inverse_over(hessian: FloatArray, free: BoolArray) -> FloatArray | None:
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
