"""MTF50 in the units that people ask for, with its uncertainty.

ISO 12233:2023, clause 4: line widths per picture height are ``2 f H``, with the frequency ``f`` in
cycles per pixel and the picture's height ``H`` in pixels; a line pair is one cycle.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin, tan

from calibration.edges import EdgeImage, EdgeMeasurement
from calibration.sharpness.lateral_colour import with_colour_shifts

NORMAL_95 = 1.959963984540054
"""Half width of a 95 % interval in standard errors."""

_SERIES_BELOW = 1e-4  # where sinc'/sinc is -pi^2 f / 3 to 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Mtf50:
    """Frequency of half contrast across an edge, in cy/px, and half its 95 % interval.

    ``is_model_free`` tells the e-SFR from the fitted Gaussian. ``reach_95`` is None where the
    error is not known.
    """

    cy_per_px: float
    err_cy_per_px: float | None
    is_model_free: bool

    @property
    def reach_95_cy_per_px(self) -> float | None:
        """Half width of the 95 % interval."""
        return None if self.err_cy_per_px is None else NORMAL_95 * self.err_cy_per_px


def reported_mtf50(edge: EdgeMeasurement) -> Mtf50:
    """Return the MTF50 to report for an edge: of its e-SFR, else of the fitted Gaussian.

    The e-SFR assumes no shape of the PSF, as ISO 12233 asks. Where an edge does not determine it
    with an error (too short, phases with gaps, contrast above a half at 1 cy/px), the Gaussian's
    stands in, and ``is_model_free`` says so.
    """
    value, err = edge.esfr_mtf50_cy_per_px, edge.esfr_mtf50_err_cy_per_px
    if value is not None and err is not None:
        return Mtf50(cy_per_px=value, err_cy_per_px=err, is_model_free=True)
    known = edge.mtf50_err_cy_per_px
    return Mtf50(
        cy_per_px=edge.mtf50_cy_per_px,
        err_cy_per_px=gaussian_mtf50_err(edge) if known is None else known,
        is_model_free=False,
    )


def lw_per_ph(cy_per_px: float, picture_height_px: float) -> float:
    """Convert cycles per pixel to line widths per picture height."""
    return 2.0 * cy_per_px * picture_height_px


def lp_per_mm(cy_per_px: float, pixel_pitch_um: float) -> float:
    """Convert cycles per pixel to line pairs per millimetre on the sensor."""
    return 1000.0 * cy_per_px / pixel_pitch_um


def picture_height_px(edge: EdgeMeasurement) -> float | None:
    """Return the height of an edge's own photograph; None where its units are not known."""
    if edge.mtf50_lw_per_ph is None:
        return None
    return edge.mtf50_lw_per_ph / lw_per_ph(edge.mtf50_cy_per_px, 1.0)


def gaussian_mtf50_err(edge: EdgeMeasurement) -> float:
    """Standard error of the fitted Gaussian's MTF50, from that of its width.

    The frequency is inversely proportional to a total width. With the pixel apart from the lens,
    it follows from ``T(f, sigma) = 1/2`` by implicit differentiation.
    """
    if edge.optical_sigma_px is None or edge.optical_sigma_err_px is None:
        return edge.mtf50_cy_per_px * edge.sigma_err_px / edge.sigma_px
    freq, sigma = edge.mtf50_cy_per_px, edge.optical_sigma_px
    by_sigma = 4 * pi**2 * sigma * freq**2
    by_freq = 4 * pi**2 * sigma**2 * freq
    for share in (cos(edge.normal_rad), sin(edge.normal_rad)):
        by_freq -= share * _log_sinc_slope(freq * share)
    return edge.optical_sigma_err_px * by_sigma / by_freq


def _log_sinc_slope(x: float) -> float:
    """Derivative of ``log(sin(pi x) / (pi x))``."""
    if abs(x) < _SERIES_BELOW:
        return -(pi**2) * x / 3
    return pi / tan(pi * x) - 1 / x


def with_sharpness(edges: Sequence[EdgeMeasurement], source: EdgeImage) -> list[EdgeMeasurement]:
    """Return the edges with MTF50 in all units and, in colour, with their shifts.

    Parameters
    ----------
    edges
        As measured on ``source``.
    source
        The photograph: its height, its pixel pitch and its colours, as far as they are known.
    """
    height_px, pitch_um = source.frame[0], source.pixel_pitch_um
    found = []
    for edge in edges:
        esfr = edge.esfr_mtf50_cy_per_px
        values: dict[str, float | None] = {
            "mtf50_err_cy_per_px": gaussian_mtf50_err(edge),
            "mtf50_lw_per_ph": lw_per_ph(edge.mtf50_cy_per_px, height_px),
            "esfr_mtf50_lw_per_ph": None if esfr is None else lw_per_ph(esfr, height_px),
        }
        if pitch_um is not None:
            values["mtf50_lp_per_mm"] = lp_per_mm(edge.mtf50_cy_per_px, pitch_um)
            values["esfr_mtf50_lp_per_mm"] = None if esfr is None else lp_per_mm(esfr, pitch_um)
        found.append(edge.model_copy(update=values))
    return with_colour_shifts(found, source)
