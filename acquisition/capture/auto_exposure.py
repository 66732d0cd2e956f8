"""Exposure times: the next one to try for a well-lit picture, and the flicker of mains light."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from acquisition.bracket import ExposureControl
from acquisition.devices import Camera
from acquisition.errors import CaptureError

EXPOSURE_AIM = 0.7
"""Fraction of the range above the black level that the brightest parts should reach."""

TOLERANCE = 0.1
LEAST_RATIO = 1.2
"""Of two exposures of a bracket, below which whole periods of flicker are not worth it."""

SHORTEST_EXPOSURE_US = 50.0
EXPOSURE_TRIALS = 8
TRIAL_FRAMES = 2
BRIGHT_PERCENTILE = 99.5

SATURATED_STEP = 4.0
LARGEST_STEP = 16.0

ExposureLimit = Literal["shortest", "longest", "flicker"]
"""What keeps an exposure from the wanted level: a limit, or that it is whole periods of flicker."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureStep:
    """The exposure to set next; ``is_settled`` means that the present one may stay.

    ``limited_by`` says what keeps it more than 10 % from the one that was wanted; empty if nothing
    does.
    """

    exposure_us: float
    is_settled: bool
    limited_by: tuple[ExposureLimit, ...] = ()


def next_exposure(
    exposure_us: float,
    bright_dn: float,
    *,
    black_level_dn: float,
    max_level_dn: float,
    limits_us: tuple[float, float],
    mains_hz: float = 0.0,
) -> ExposureStep:
    """Return the exposure that brings the bright parts of an image to 70 % of the range.

    The camera is linear, so that one step from an unsaturated image suffices; a saturated one
    says no more than "shorter".

    Parameters
    ----------
    exposure_us
        Exposure of the image that was taken.
    bright_dn
        Level reached by its brightest parts, such as the 99.5th percentile.
    limits_us
        Shortest and longest exposure that may be set.
    mains_hz
        Mains frequency, if the light flickers with it: exposures longer than one period of the
        flicker are whole multiples of it. 0 for light that does not flicker.

    Raises
    ------
    ValueError
        If the exposure or the limits are not positive and in order.
    """
    shortest_us, longest_us = limits_us
    if not (0 < shortest_us <= longest_us and exposure_us > 0):
        raise ValueError(
            "exposure and limits must be positive and in order, "
            f"got {exposure_us} us, {limits_us} us"
        )
    span_dn = max_level_dn - black_level_dn
    light = (bright_dn - black_level_dn) / span_dn
    if bright_dn >= max_level_dn:
        factor = 1 / SATURATED_STEP
    else:
        factor = min(EXPOSURE_AIM / max(light, EXPOSURE_AIM / LARGEST_STEP), LARGEST_STEP)
    wanted_us = exposure_us * factor
    clipped_us = min(max(wanted_us, shortest_us), longest_us)
    asked_us = max(without_flicker(clipped_us, mains_hz), shortest_us)
    # Whole periods cannot come closer than half of one; there the present one stays.
    is_settled = abs(asked_us - exposure_us) <= TOLERANCE * exposure_us
    applied: dict[ExposureLimit, bool] = {
        "shortest": wanted_us < shortest_us,
        "longest": wanted_us > longest_us,
        "flicker": asked_us < clipped_us,
    }
    set_us = exposure_us if is_settled else asked_us
    is_wanted = abs(wanted_us - set_us) <= TOLERANCE * set_us
    return ExposureStep(
        exposure_us=set_us,
        is_settled=is_settled,
        limited_by=() if is_wanted else tuple(limit for limit, is_so in applied.items() if is_so),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundExposure:
    """An exposure as read back, and the fraction of the range that the brightest parts reach.

    ``limited_by`` says why that is not 70 %, to 10 %; empty if it is.
    """

    exposure_us: float
    bright_fraction: float
    limited_by: tuple[ExposureLimit, ...] = ()


def find_exposure(
    camera: Camera,
    exposures: ExposureControl,
    *,
    limits_us: tuple[float, float],
    mains_hz: float,
) -> FoundExposure:
    """Set the exposure for the brightest parts of what the camera sees, beginning with its own.

    Parameters
    ----------
    exposures
        Of this camera, which must not be streaming.
    limits_us, mains_hz
        As for `next_exposure`.

    Raises
    ------
    CaptureError
        If none is found in eight trials, or the camera sends no frames.
    CameraFeatureError
        If the camera sets another exposure.
    """
    exposure_us = camera.settings.exposure_us
    for _ in range(EXPOSURE_TRIALS):
        taken = exposures.average(TRIAL_FRAMES, exposure_us)
        settings = camera.settings
        bright_dn = float(np.percentile(taken.averaged.mean_dn, BRIGHT_PERCENTILE))
        step = next_exposure(
            settings.exposure_us,
            bright_dn,
            black_level_dn=settings.black_level_dn,
            max_level_dn=settings.max_level_dn,
            limits_us=limits_us,
            mains_hz=mains_hz,
        )
        if step.is_settled:
            span_dn = settings.max_level_dn - settings.black_level_dn
            return FoundExposure(
                exposure_us=settings.exposure_us,
                bright_fraction=(bright_dn - settings.black_level_dn) / span_dn,
                limited_by=step.limited_by,
            )
        exposure_us = step.exposure_us
    raise CaptureError(
        f"no exposure was found in {EXPOSURE_TRIALS} trials; is the light steady? "
        "Set the exposure by hand",
        frames_complete=0,
        frames_asked=TRIAL_FRAMES,
    )


def without_flicker(exposure_us: float, mains_hz: float) -> float:
    """Shorten an exposure to whole periods of the flicker, if it lasts at least one."""
    if mains_hz <= 0:
        return exposure_us
    period_us = 0.5e6 / mains_hz
    periods = math.floor(exposure_us / period_us + 1e-9)
    return periods * period_us if periods else exposure_us


def bracket_exposures_us(
    shortest_us: float, ratios: Sequence[float], mains_hz: float
) -> tuple[float, ...]:
    """Exposures of a bracket, ascending; longer ones in whole periods of the flicker.

    Parameters
    ----------
    shortest_us
        The first, which stays as it is.
    ratios
        The exposures as multiples of it, ascending from 1.
    mains_hz
        As for `without_flicker`.
    """
    exposures_us = [shortest_us]
    for ratio in ratios[1:]:
        asked_us = shortest_us * ratio
        whole_us = without_flicker(asked_us, mains_hz)
        is_apart = whole_us >= LEAST_RATIO * exposures_us[-1]
        exposures_us.append(whole_us if is_apart else asked_us)
    return tuple(exposures_us)


def flicker_fraction(exposure_us: float, mains_hz: float) -> float:
    """Amplitude of the flicker left in a capture, as a fraction of that of the light itself.

    Lamps on the mains flicker at twice its frequency f; an exposure T averages that down to
    ``|sin(2 pi f T) / (2 pi f T)|``, which is 0 for whole periods. Also 0 for ``mains_hz`` 0.
    """
    if mains_hz <= 0:
        return 0.0
    phase = 2.0 * math.pi * mains_hz * exposure_us * 1e-6
    return abs(math.sin(phase) / phase)
