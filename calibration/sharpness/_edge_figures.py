"""What a laboratory reads off an edge: contrast at set frequencies, rise, over- and undershoot.

All of it comes from the e-SFR of ``calibration.edges`` and its edge profile, whatever the shape of
the PSF. Over- and undershoot are those of the edge profile in ISO 12233:2024: how far it goes
beyond its flat ends, over their difference. No lens makes any: light is not negative, so that the
profile behind a lens and pixels only rises. Where it is there beyond doubt, the photograph was
sharpened, or compressed so strongly that it rings.

References
----------
ISO 12233:2024, "Digital cameras - Resolution and spatial frequency responses", annex D. MTF50P, of
half the largest contrast, is Imatest's: sharpening raises it less than MTF50.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin, sqrt
from typing import Final

import numpy as np
from scipy.special import ndtri

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement, EdgeSfr
from calibration.estimate import Estimate
from calibration.robust import median_err
from calibration.sharpness._resolution import reported_mtf50
from simulation.arrays import FloatArray

NYQUIST: Final = 0.5
_STEP_CY_PER_PX = 1 / 400
_GRID: Final[FloatArray] = np.arange(401.0) * _STEP_CY_PER_PX
_SLOPE_STEP = 1e-3
_RISK = 0.05
_REACH_SIGMAS, _REACH_EXTRA_PX = 3.0, 3.0  # where sharpening by usual radii shows
_PROFILE_STEP_PX = 0.125
_LEAST_OVERSHOOT = 0.01
"""Of the contrast: less is within what uneven light and flare do to the flat ends."""
_RISES_FROM, _RISES_TO = 0.1, 0.9


class MeasuredValue(StoredModel):
    """A value and its standard error."""

    value: float
    err: float

    @property
    def estimate(self) -> Estimate:
        """The value with its 95 % interval."""
        return Estimate(value=self.value, err=self.err)


class EdgeFigures(StoredModel):
    """Figures of one edge, or of several; None where the edges do not determine one.

    ``mtf50p_cy_per_px``: where half of the largest contrast is left; ``mtf20_..``, ``mtf10_..``: a
    fifth and a tenth of that at frequency 0. ``mtf_at_nyquist``, ``mtf_at_half_nyquist``: contrast
    at 0.5 and 0.25 cy/px. ``overshoot``, ``undershoot``: of the edge profile beyond its bright and
    its dark level, over their difference. ``rise_px``: distance from 10 to 90 %. Those of the
    fitted Gaussian are not ``is_model_free``.
    """

    mtf50_cy_per_px: MeasuredValue | None = None
    mtf50p_cy_per_px: MeasuredValue | None = None
    mtf20_cy_per_px: MeasuredValue | None = None
    mtf10_cy_per_px: MeasuredValue | None = None
    mtf_at_half_nyquist: MeasuredValue | None = None
    mtf_at_nyquist: MeasuredValue | None = None
    overshoot: MeasuredValue | None = None
    undershoot: MeasuredValue | None = None
    rise_px: MeasuredValue | None = None
    is_model_free: bool = True


FIGURE_NAMES: Final = tuple(name for name in EdgeFigures.model_fields if name != "is_model_free")


def edge_figures(edge: EdgeMeasurement) -> EdgeFigures:
    """Return the figures of an edge, by the rule of `reported_mtf50`.

    They are those of its e-SFR; of an edge without one those of its fitted Gaussian, with no over-
    and undershoot. What uneven light and JPEG compression add to the error of MTF50 is in the
    errors of the other figures in proportion.
    """
    half = reported_mtf50(edge)
    mtf50 = MeasuredValue(value=half.cy_per_px, err=half.err_cy_per_px or 0.0)
    if edge.esfr is None or not half.is_model_free:
        return _of_gaussian(edge, mtf50)
    return _Read(esfr=edge.esfr, sigma_px=edge.sigma_px, mtf50=mtf50).figures()


def _of_gaussian(edge: EdgeMeasurement, mtf50: MeasuredValue) -> EdgeFigures:
    """Figures of the Gaussian that was fitted, before the pixel's square if it has one."""
    cosine, sine = cos(edge.normal_rad), sin(edge.normal_rad)
    optical = edge.optical_sigma_px

    def contrast(freq: FloatArray) -> FloatArray:
        if optical is None:
            return np.asarray(np.exp(-2 * (pi * edge.sigma_px * freq) ** 2))
        lens = np.exp(-2 * (pi * optical * freq) ** 2)
        return np.asarray(lens * np.sinc(freq * cosine) * np.sinc(freq * sine))

    relative = mtf50.err / mtf50.value  # of the width, and of every frequency

    def falls_to(level: float) -> MeasuredValue | None:
        below = np.flatnonzero(contrast(_GRID) < level)
        if below.size == 0:
            return None
        high, low = contrast(_GRID[below[0] - 1 : below[0] + 1]).tolist()
        freq = float(_GRID[below[0] - 1] + _STEP_CY_PER_PX * (high - level) / (high - low))
        return MeasuredValue(value=freq, err=freq * relative)

    def contrast_at(freq: float) -> MeasuredValue:
        here, wider = contrast(np.array([freq, freq * (1 + _SLOPE_STEP)])).tolist()
        return MeasuredValue(value=here, err=abs(wider - here) / _SLOPE_STEP * relative)

    rise = float(ndtri(_RISES_TO) - ndtri(_RISES_FROM))
    return EdgeFigures(
        mtf50_cy_per_px=mtf50,
        mtf50p_cy_per_px=mtf50,
        mtf20_cy_per_px=falls_to(0.2),
        mtf10_cy_per_px=falls_to(0.1),
        mtf_at_half_nyquist=contrast_at(0.5 * NYQUIST),
        mtf_at_nyquist=contrast_at(NYQUIST),
        rise_px=MeasuredValue(value=rise * edge.sigma_px, err=rise * edge.sigma_err_px),
        is_model_free=False,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Read:
    """An e-SFR, read at frequencies and distances."""

    esfr: EdgeSfr
    sigma_px: float
    mtf50: MeasuredValue

    def figures(self) -> EdgeFigures:
        """All figures."""
        over, under = self._beyond()
        return EdgeFigures(
            mtf50_cy_per_px=self.mtf50,
            mtf50p_cy_per_px=self._falls_to(0.5 * float(self._contrast.max())),
            mtf20_cy_per_px=self._falls_to(0.2),
            mtf10_cy_per_px=self._falls_to(0.1),
            mtf_at_half_nyquist=self._contrast_at(0.5 * NYQUIST),
            mtf_at_nyquist=self._contrast_at(NYQUIST),
            overshoot=over,
            undershoot=under,
            rise_px=self._rise(),
        )

    @cached_property
    def _contrast(self) -> FloatArray:
        return self.esfr.at(_GRID)

    @cached_property
    def _widened(self) -> float:
        """How many times the pixels' noise the error of MTF50 is."""
        by_noise = self._frequency_err(self.mtf50.value)
        return max(self.mtf50.err / by_noise, 1.0) if by_noise else 1.0

    def _frequency_err(self, freq: float) -> float | None:
        """Standard error of a frequency at which the contrast falls to a level, by noise alone."""
        around = self.esfr.at(np.array([freq - _SLOPE_STEP, freq + _SLOPE_STEP]))
        slope = float(around[1] - around[0]) / (2 * _SLOPE_STEP)
        err = float(self.esfr.transform_err(np.array([freq]))[0])
        return err / -slope if slope < 0 else None

    def _falls_to(self, level: float) -> MeasuredValue | None:
        """Frequency beyond the peak at which the contrast falls to a level."""
        peak = int(np.argmax(self._contrast))
        below = np.flatnonzero(self._contrast[peak:] < level)
        if below.size == 0:
            return None
        last = peak + int(below[0])
        high, low = self._contrast[last - 1 : last + 1].tolist()
        freq = float(_GRID[last - 1] + _STEP_CY_PER_PX * (high - level) / (high - low))
        err = self._frequency_err(freq)
        return None if err is None else MeasuredValue(value=freq, err=err * self._widened)

    def _contrast_at(self, freq: float) -> MeasuredValue:
        here = np.array([freq])
        err = float(self.esfr.transform_err(here)[0]) * self._widened
        return MeasuredValue(value=float(self.esfr.at(here)[0]), err=err)

    def _beyond(self) -> tuple[MeasuredValue, MeasuredValue]:
        """How far the profile goes beyond the bright level, and beyond the dark one."""
        out = outside_px(self.sigma_px, self.esfr.reach_px)
        found = []
        for side in (1.0, -1.0):
            away = beyond_level(self.esfr, side, out)
            at = int(np.argmax(away))
            err = float(self.esfr.esf_err(side * out[at : at + 1])[0])
            found.append(MeasuredValue(value=max(float(away[at]), 0.0), err=err))
        return found[0], found[1]

    def _rise(self) -> MeasuredValue | None:
        """Distance from a tenth to nine tenths of the contrast."""
        reach = min(4.0 * self.sigma_px + 2.0, self.esfr.reach_px)
        distance = np.arange(-reach, reach, 0.25 * _PROFILE_STEP_PX)
        profile = self.esfr.esf(distance)
        places, variance = [], 0.0
        for level in (_RISES_FROM, _RISES_TO):
            above = np.flatnonzero(profile >= level)
            if above.size == 0 or above[0] == 0:
                return None
            last = int(above[0])
            low, high = profile[last - 1 : last + 1].tolist()
            step = float(distance[1] - distance[0])
            place = float(distance[last - 1]) + step * (level - low) / (high - low)
            err = float(self.esfr.esf_err(np.array([place]))[0])
            variance += (err * step / (high - low)) ** 2
            places.append(place)
        return MeasuredValue(value=places[1] - places[0], err=sqrt(variance) * self._widened)


def outside_px(sigma_px: float, reach_px: float) -> FloatArray:
    """Distances from an edge at which an overshoot is looked for."""
    farthest = min(_REACH_SIGMAS * sigma_px + _REACH_EXTRA_PX, reach_px)
    return np.arange(0.5 * sigma_px, farthest, _PROFILE_STEP_PX)


def beyond_level(esfr: EdgeSfr, side: float, out_px: FloatArray) -> FloatArray:
    """How far the profile is beyond its bright (side 1) or dark level (-1), over the contrast."""
    profile = esfr.esf(side * out_px)
    return profile - 1.0 if side > 0 else -profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Sharpening:
    """Whether photographs were sharpened, by the profiles of all their edges.

    ``overshoot`` and ``undershoot`` are those of the median profile; ``is_found`` says that one of
    them is beyond what noise and uneven light can do.
    """

    overshoot: Estimate
    undershoot: Estimate
    is_found: bool

    @property
    def sentence(self) -> str:
        """What was found, in words."""
        over, under = (f"{100 * one.value:.1f} %" for one in (self.overshoot, self.undershoot))
        if not self.is_found:
            return (
                "The edge profile shows no overshoot beyond its uncertainty: no sign of sharpening."
            )
        return (
            f"The photographs are sharpened: the edge profile overshoots by {over} and undershoots "
            f"by {under} of the contrast, which no lens does. MTF50 and other figures are those of "
            "lens and processing together."
        )


def sharpening_of(edges: Sequence[EdgeMeasurement]) -> Sharpening | None:
    """Return whether photographs were sharpened; None without an edge that has an e-SFR.

    At each distance from the edges the median is taken over them. A profile of so many independent
    places goes beyond its level somewhere by chance: the largest excess counts where it is
    significant at 5 % for all places together (Bonferroni), and 1 % of the contrast or more.
    """
    known = [(edge.esfr, edge.sigma_px) for edge in edges if edge.esfr is not None]
    if not known:
        return None
    sigma_px = float(np.median([sigma for _, sigma in known]))
    out = outside_px(sigma_px, min(esfr.reach_px for esfr, _ in known))
    places = max((out[-1] - out[0]) / sigma_px, 1.0)
    surprising = float(ndtri(1 - _RISK / (2 * places)))
    found, is_found = [], False
    for side in (1.0, -1.0):
        curves = np.array([beyond_level(esfr, side, out) for esfr, _ in known])
        errs = np.array([esfr.esf_err(side * out) for esfr, _ in known])
        middle, err = np.median(curves, axis=0), median_err(curves, errs)
        at = int(np.argmax(middle))
        is_found |= bool(middle[at] > max(surprising * err[at], _LEAST_OVERSHOOT))
        found.append(Estimate(value=max(float(middle[at]), 0.0), err=float(err[at])))
    return Sharpening(overshoot=found[0], undershoot=found[1], is_found=is_found)


def median_figures(figures: Sequence[EdgeFigures]) -> EdgeFigures:
    """Return the median of each figure over edges, with its error by noise and scatter."""
    is_model_free = all(one.is_model_free for one in figures)
    return EdgeFigures.model_validate({**dict(_medians(figures)), "is_model_free": is_model_free})


def _medians(figures: Sequence[EdgeFigures]) -> Iterator[tuple[str, MeasuredValue | None]]:
    for name in FIGURE_NAMES:
        known = [value for one in figures if (value := getattr(one, name)) is not None]
        if not known:
            yield name, None
            continue
        values = np.array([[one.value] for one in known])
        err = median_err(values, np.array([[one.err] for one in known]))
        yield name, MeasuredValue(value=float(np.median(values)), err=float(err[0]))
