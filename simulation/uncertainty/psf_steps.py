"""Neighbours of a PSF by which its statistical error is carried into an image.

The parameters of a PSF are correlated, and most of their combinations hardly change what a camera
further away sees. With ``J`` the derivative of ``H(z f) / H(f)``, weighted by what an average
scene has at each frequency, and ``C = L L^T`` the covariance of the parameters, the singular
vectors ``v`` of ``J L`` are the directions that matter, and ``L v`` steps of one standard error
that are independent of each other.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.psf import Psf, PsfField
from simulation.zoom_kernels import SCENE_CORRELATION_PX

_KEPT = 0.999
"""Part of the variance of an average scene's response that the steps kept explain."""

_LEAST_RESPONSE = 2e-3
"""Of the scene's standard deviation: kernels are cut off where they matter less than a tenth of
it, and a smaller step would measure where they end."""

_LONGEST = 64.0
_SHORTEST = 1 / 16
_NEAR_ZERO = 3e-3
_SLOPE_STEP = 0.1
_FREQUENCIES = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfStep:
    """Two PSFs on either side of the calibrated one.

    Parameters
    ----------
    plus, minus
        The PSFs; one of them is the calibrated one where the other side is no PSF.
    length
        Standard errors from ``minus`` to ``plus``: the difference of two images over it is the
        change by one standard error.
    """

    plus: Psf | PsfField
    minus: Psf | PsfField
    length: float


def principal_steps(
    psf_of: Callable[[FloatArray], Psf], values: FloatArray, covariance: FloatArray, zoom: float
) -> tuple[PsfStep, ...]:
    """Return the independent steps of one standard error that matter to a follow-up.

    Parameters
    ----------
    psf_of
        The PSF of parameters, with a ValueError where there is none.
    values, covariance
        The parameters, shape ``(n,)``, and the covariance of their errors.
    zoom
        Of the follow-up; it need only be about right.

    Returns
    -------
    tuple of PsfStep
        Their responses explain 99.9 % of the variance of an average scene's; none if the
        covariance is zero.
    """
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    columns = [_slope(psf_of, values, root[:, k], zoom) for k in range(len(values))]
    _, strength, turned = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
    total = float(np.sum(strength**2))
    if not total > 0:
        return ()
    missing = 1 - np.cumsum(strength**2) / total
    count = int(np.argmax(missing <= 1 - _KEPT)) + 1
    return tuple(_step(psf_of, values, root @ turned[k], float(strength[k])) for k in range(count))


def _slope(
    psf_of: Callable[[FloatArray], Psf], values: FloatArray, step: FloatArray, zoom: float
) -> FloatArray:
    """Change of a scene's image by a step, weighted by frequency, shape ``(n,)``."""
    if not np.any(step):
        return np.zeros(_response(psf_of(values), zoom).size)
    sides = _sides(psf_of, values, step, _SLOPE_STEP)
    return (_response(sides.plus, zoom) - _response(sides.minus, zoom)) / sides.length


def _response(psf: Psf | PsfField, zoom: float) -> FloatArray:
    """``H(z f) H(f) / (H(f)^2 + e^2) H(f)`` over the pixels' band, times an average scene."""
    assert not isinstance(psf, PsfField)
    steps = np.arange(-_FREQUENCIES, _FREQUENCIES + 1) / (2 * _FREQUENCIES)
    fy, fx = steps[_FREQUENCIES:, None], steps[None, :]
    near, far = psf.otf(fx, fy), psf.otf(zoom * fx, zoom * fy)
    radius2 = (2 * np.pi * SCENE_CORRELATION_PX) ** 2 * (fx**2 + fy**2)
    power = 2 * np.pi * SCENE_CORRELATION_PX**2 / (1 + radius2) ** 1.5
    # Each frequency of this half plane stands for its opposite, too.
    weight = np.sqrt(2 * power) / (2 * _FREQUENCIES)
    return np.asarray(far * near**2 / (near**2 + _NEAR_ZERO**2) * weight).ravel()


def _step(
    psf_of: Callable[[FloatArray], Psf], values: FloatArray, step: FloatArray, response: float
) -> PsfStep:
    return _sides(psf_of, values, step, float(np.clip(_LEAST_RESPONSE / response, 1.0, _LONGEST)))


def _sides(
    psf_of: Callable[[FloatArray], Psf], values: FloatArray, step: FloatArray, length: float
) -> PsfStep:
    """The PSFs on either side, or on one, as far away as asked for or as there are any."""
    while length >= _SHORTEST * _SLOPE_STEP:
        plus, minus = (_psf(psf_of, values + sign * length * step) for sign in (1.0, -1.0))
        if plus is not None and minus is not None:
            return PsfStep(plus=plus, minus=minus, length=2 * length)
        if plus is not None:
            return PsfStep(plus=plus, minus=psf_of(values), length=length)
        if minus is not None:
            return PsfStep(plus=psf_of(values), minus=minus, length=length)
        length /= 2
    raise ValueError("the PSF's parameters have no neighbours that are a PSF")


def _psf(psf_of: Callable[[FloatArray], Psf], values: FloatArray) -> Psf | None:
    try:
        with np.errstate(invalid="ignore"):  # a root of a negative value is refused as no number
            return psf_of(values)
    except ValueError:
        return None
