"""What the edges show beyond a parametric transfer function: whether there is something, and what.

The correction is a smooth random function of frequency: its coefficients c have the density
``exp(-c' P c / (2 v))`` with the integral P of squared second derivatives. Its variance v is the
one that makes the edges most likely, which also says how much more likely than none.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.psf.otf_fit import (
    LEAST_GAIN,
    OtfFit,
    bounded_step,
    free_parameters,
    inverse_over,
    normal_equations,
)
from calibration.psf.otf_forms import OtfForm
from calibration.psf.otf_slices import EdgeStack
from simulation.arrays import FloatArray
from simulation.psf import correction_roughness

_VARIANCES = np.logspace(-14, 2, 81)  # 0.2 apart in the exponent: of the likelihood, less than 0.1
_STEPS = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrectionEvidence:
    """How likely a correction with this many harmonics is, beside a fit without one.

    ``curvatures`` and ``pulls``, shape ``(coefficients,)`` each, are the diagonal normal matrix of
    the coefficients and its right side, in coordinates in which the prior density is round and
    after the fit's own parameters.
    """

    harmonics: int
    curvatures: FloatArray
    pulls: FloatArray

    def log_likelihood(self, scatter: float) -> float:
        """Twice the logarithm of the likelihood over that of no correction, at its best.

        ``scatter`` is a factor on the variance of the pixels' noise.
        """
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
    hessian, gradient = normal_equations(stack, form, start, here)
    count = fit.parameters.size
    # A parameter at its bound must not seem to explain what only a correction can.
    own = np.flatnonzero(free_parameters(form, start, gradient)[:count])
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
    hessian, gradient = normal_equations(stack, form, best, here)
    damping = 1e-6
    for k in range(_STEPS):
        pull = gradient - penalty @ best
        step = bounded_step(hessian + penalty, pull, best - form.least, damping)
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
        hessian, gradient = normal_equations(stack, form, best, here)
        if gain <= LEAST_GAIN * here.squares / stack.bins:
            break
    free = free_parameters(form, best, gradient - penalty @ best)
    inverse = inverse_over(hessian + penalty, free)
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
