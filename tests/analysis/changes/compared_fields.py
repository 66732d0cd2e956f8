"""Smoothed differences whose truth is known in closed form."""

from typing import Any

import numpy as np

from analysis.changes import Change
from analysis.changes._change_list import list_changes
from analysis.changes._comparison import Comparison
from analysis.changes._levels import detection_levels
from analysis.changes._regions import LinkedRegion, link_levels
from analysis.changes.matching import FittedScatter, Smoothing, WhiteNoiseGain
from calibration.registration import DistortedPose
from simulation.arrays import BoolArray, FloatArray

WHITE = FittedScatter(
    gains=WhiteNoiseGain(source=0.5, target=0.5),
    noise_dn2=1.0,
    white_dn2=1.0,
    structure_share=0.0,
    displaced=0.0,
)
"""Of a difference that is noise alone."""


def change_at(x_px: float, y_px: float, amplitude_dn: float, **others: Any) -> Change:
    """A change at the same place in both photographs."""
    about: dict[str, Any] = {
        "reference_x_px": x_px,
        "reference_y_px": y_px,
        "area_px": 9.0,
        "amplitude_err_dn": 1.0,
        "significance": abs(amplitude_dn),
        "q_value": 1e-9,
    }
    return Change(x_px=x_px, y_px=y_px, amplitude_dn=amplitude_dn, **(about | others))


def at_rest(shape: tuple[int, int], matrix: FloatArray | None = None) -> DistortedPose:
    """The pose of a follow-up of the same shape, at rest unless a matrix is given."""
    own = np.eye(3) if matrix is None else matrix
    return DistortedPose(matrix=own, k1=0.0, reference_shape=shape, followup_shape=shape)


def spot(
    shape: tuple[int, int], place_px: tuple[float, float], amplitude: float, variance_px2: float
) -> FloatArray:
    """A Gaussian with this peak and variance at ``(y, x)``."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    square = (y - place_px[0]) ** 2 + (x - place_px[1]) ** 2
    return np.asarray(amplitude * np.exp(-square / (2 * variance_px2)))


def smoothed_spot(
    shape: tuple[int, int],
    place_px: tuple[float, float],
    amplitude: float,
    sigma_px: float,
    smoothing_px: float,
) -> FloatArray:
    """The same behind a Gaussian smoothing: wider, and lower by the ratio of the areas."""
    wide = sigma_px**2 + smoothing_px**2
    return spot(shape, place_px, amplitude * sigma_px**2 / wide, wide)


def smoothed_noise(
    rng: np.random.Generator, shape: tuple[int, int], smoothing_px: float
) -> FloatArray:
    """White noise behind a Gaussian, of unit variance."""
    freq_y, freq_x = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None]
    transfer = np.exp(-2 * (np.pi * smoothing_px) ** 2 * (freq_y**2 + freq_x**2))
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * transfer, s=shape)
    return np.asarray(field * 2 * np.sqrt(np.pi) * smoothing_px)


def comparison(
    difference_dn: FloatArray,
    sd_dn: float | FloatArray = 1.0,
    *,
    valid: BoolArray | None = None,
    smoothing_px: float = 1.0,
    is_on_followup: bool = True,
) -> Comparison:
    """A comparison with this difference."""
    if valid is None:
        valid = np.ones(difference_dn.shape, dtype=np.bool_)
    return Comparison(
        scatter=WHITE,
        is_on_followup=is_on_followup,
        difference_dn=np.where(valid, difference_dn, 0.0),
        plain_difference_dn=difference_dn,
        sd_dn=np.broadcast_to(sd_dn, difference_dn.shape),
        valid=valid,
        smoothing_px=smoothing_px,
        smoothing=Smoothing(source_px=smoothing_px, target_px=smoothing_px),
        target_dn=np.where(valid, difference_dn, 0.0).astype(np.float32),
        matched_scale=1.0,
        kernel="pair",
        extra_blur_px2=0.0,
        extra_blur_err_px2=1.0,
        gain=1.0,
        gain_err=0.01,
        noise_factor=1.0,
        registration_err_px=0.0,
        width_err_px2=0.0,
    )


def listed(compared: Comparison, pose: DistortedPose, threshold_sd: float) -> tuple[Change, ...]:
    """The changes of a comparison beyond a threshold."""
    return regions_and_changes(compared, pose, threshold_sd)[1]


def regions_and_changes(
    compared: Comparison, pose: DistortedPose, threshold_sd: float
) -> tuple[tuple[LinkedRegion, ...], tuple[Change, ...]]:
    """The same with the pixels of each."""
    levels = detection_levels(compared, 1e-6)
    found = link_levels(levels, threshold_sd)
    return found.regions, list_changes(found.regions, levels, compared, pose)
