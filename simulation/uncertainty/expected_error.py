"""The error that a model itself states: what the reference's pixels do not tell of the follow-up.

A reference holds frequencies up to its pixels' limit, and folds those beyond onto them. For scenes
of the covariance that ``docs/theory-lmmse.md`` assumes, with ``S`` its spectrum, ``D`` what two
reference pixels share, ``H1`` and ``H2`` the transfer functions near and far (the latter in the
reference's frequencies) and ``K`` that of the model, the error is, over all subpixel positions,

    integral of S H2^2 - 2 K S H1 H2 + K^2 D

How strong a scene is at a place is told by the squared steps between its pixels there.
"""

from functools import lru_cache

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter, map_coordinates

from simulation.arrays import FloatArray
from simulation.choices import Model
from simulation.pose import LocalPose, derivatives, poses_at_followup
from simulation.psf import Psf, PsfField
from simulation.uncertainty.view import SimulatedView
from simulation.zoom_kernels import SCENE_CORRELATION_PX, SeenScene

_PERIOD_PX = 64
_RIDGE = 1e-6
_NEAR_ZERO = 3e-3  # as the kernels of model matched
_POINTS = 5
"""Positions per axis at which errors are computed; linear between."""

_WINDOW_ZOOMS = 2.0
"""Width of the window in which the scene's strength is measured, in follow-up pixels."""

_STATED: tuple[Model, ...] = ("matched", "lmmse")


def model_variance(
    view: SimulatedView, psf: Psf | PsfField, reference: FloatArray, noise_dn2: FloatArray | None
) -> FloatArray | None:
    """Return the model's expected squared error at each pixel of a follow-up.

    Parameters
    ----------
    view, psf
        What is simulated.
    reference
        Levels, shape ``(rows, cols)``.
    noise_dn2
        Variance of the reference's noise, same shape, which is no structure of the scene; None if
        it is not known.

    Returns
    -------
    ndarray of shape (height, width), or None
        None for a model that states no error.
    """
    if view.model not in _STATED:
        return None
    seen = view.survey()
    if view.pose_view(psf).is_by_whole_pixels:
        return np.zeros(seen.shape[:2])
    strength = _strength(reference, psf, view.zoom, noise_dn2)
    places = seen[..., 1], seen[..., 0]
    local = map_coordinates(strength, places, order=1, mode="nearest")
    return np.asarray(local * _error_over_followup(view, psf))


def _strength(
    reference: FloatArray, psf: Psf | PsfField, zoom: float, noise_dn2: FloatArray | None
) -> FloatArray:
    """Variance of a scene of the assumed covariance that has as large steps from pixel to pixel."""
    along_x = np.diff(reference, axis=1, append=reference[:, -1:]) ** 2
    along_y = np.diff(reference, axis=0, append=reference[-1:]) ** 2
    squares = 0.5 * (along_x + along_y)
    if noise_dn2 is not None:
        squares = squares - 2 * noise_dn2
    middle = psf.at(*psf.centre_px) if isinstance(psf, PsfField) else psf
    share = _scene(middle).covariance
    unit = 2 * share[0, 0] - share[0, 1] - share[1, 0]
    around = gaussian_filter(squares, _WINDOW_ZOOMS * max(zoom, 1.0), mode="reflect")
    return np.asarray(np.maximum(around, 0.0) / unit)


def _error_over_followup(view: SimulatedView, psf: Psf | PsfField) -> FloatArray:
    """Error in a scene of variance 1, shape ``(height, width)``."""
    pose = view.pose_view(psf)
    rows, cols = pose.follow_up
    y, x = (np.linspace(0.0, max(count - 1, 1), _POINTS) for count in (rows, cols))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    slopes = derivatives(pose.matrix, pose.lens, points)[1]
    errors = [
        _error(local, tuple(np.round(true, 6).ravel().tolist()), view.model)
        for local, true in zip(poses_at_followup(pose, points), slopes, strict=True)
    ]
    between = RegularGridInterpolator((y, x), np.array(errors).reshape(_POINTS, _POINTS))
    at = np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), axis=-1)
    return np.asarray(between(at))


@lru_cache(maxsize=256)
def _error(pose: LocalPose, slopes: tuple[float, ...], model: Model) -> float:
    """Error of a model made for a pose, where the camera looks along ``slopes``."""
    scene = _scene(pose.near)
    period = scene.period_px
    last = scene.power.shape[0] - 1
    steps = np.arange(-last, last + 1) / period
    fy, fx = steps[last:, None], steps[None, :]
    twice = np.where(fy > 0, 2.0, 1.0)
    known, true = (_seen(pose.far, a, fx, fy) for a in (pose.slopes, slopes))
    folded = np.fft.ifft2(scene.covariance).real
    rows = np.arange(last + 1) % period
    cols = np.arange(-last, last + 1) % period
    shared = folded[np.ix_(rows, cols)]
    if model == "lmmse":
        kernel = scene.power * scene.near * known / (shared + _RIDGE * scene.variance / period**2)
    else:
        inside = (np.abs(fx) <= 0.5) & (np.abs(fy) <= 0.5)
        near = scene.near
        kernel = np.where(inside, known * near / (near**2 + _NEAR_ZERO**2), 0.0)
    error = scene.power * true**2 - 2 * kernel * scene.power * scene.near * true
    return max(float(np.sum(twice * (error + kernel**2 * shared))), 0.0)


def _seen(far: Psf, slopes: tuple[float, ...], fx: FloatArray, fy: FloatArray) -> FloatArray:
    """Transfer of the camera far away at frequencies of the reference."""
    xu, xv, yu, yv = slopes
    return far.otf(xu * fx + yu * fy, xv * fx + yv * fy)


@lru_cache(maxsize=32)
def _scene(psf: Psf) -> SeenScene:
    return SeenScene.through(psf, _PERIOD_PX, SCENE_CORRELATION_PX)
