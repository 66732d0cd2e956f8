"""What a camera does to its picture between converter and wire, if it is left switched on."""

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hil_mocks.scene import ADC_MAX_DN

STICKS_OUT = 1.5
"""A pixel of so many times the mean of its neighbours is replaced by it (our choice)."""

LUT_EXPONENT = 0.8
"""The look-up table that is stored in the camera lifts the shadows (our choice)."""


def processed(level_dn: NDArray[np.uint16], settings: Mapping[str, float]) -> NDArray[np.uint16]:
    """Levels of 12 bits as they leave a camera with these settings, by their names.

    Without any of it switched on, the same array.
    """
    if settings["TestPattern"]:
        ramp = np.linspace(0, ADC_MAX_DN, level_dn.shape[1])
        level_dn = np.broadcast_to(ramp, level_dn.shape).astype(np.uint16)
    if settings["DefectCorrection"]:
        mean = _mean_of_neighbours(level_dn)
        level_dn = np.where(level_dn > STICKS_OUT * mean, mean, level_dn).astype(np.uint16)
    if settings["Sharpness"]:
        level_dn = _clipped(2.0 * level_dn - _mean_of_neighbours(level_dn))
    if settings["LUTEnable"] or settings["LUTEnableRed"]:
        level_dn = _power_table(LUT_EXPONENT)[level_dn]
    if settings["GammaEnable"] and settings["Gamma"] != 1.0:
        level_dn = _power_table(settings["Gamma"])[level_dn]
    if settings["DigitalShift"]:
        level_dn = _clipped(level_dn * 2.0 ** settings["DigitalShift"])
    if settings["ReverseX"]:
        level_dn = level_dn[:, ::-1]
    if settings["ReverseY"]:
        level_dn = level_dn[::-1]
    return level_dn


def _mean_of_neighbours(level_dn: NDArray[np.uint16]) -> NDArray[np.float64]:
    padded = np.pad(level_dn.astype(np.float64), ((0, 0), (1, 1)), mode="edge")
    return np.asarray((padded[:, :-2] + padded[:, 2:]) / 2)


def _clipped(level_dn: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.clip(np.rint(level_dn), 0, ADC_MAX_DN).astype(np.uint16)


@cache
def _power_table(exponent: float) -> NDArray[np.uint16]:
    """Level after a power law for each level of 12 bits."""
    levels = np.arange(ADC_MAX_DN + 1) / ADC_MAX_DN
    return np.rint(ADC_MAX_DN * levels**exponent).astype(np.uint16)
