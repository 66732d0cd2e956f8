"""Photon transfer after EMVA 1288: gain, read noise, black level, linearity, saturation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.errors import NoiseError
from calibration.noise.dark_signal import DarkSignal, dark_signal
from calibration.noise.linearity import Linearity, measure_linearity

__all__ = [
    "FIT_TOP",
    "LevelSample",
    "PhotonTransfer",
    "Saturation",
    "fit_photon_transfer",
    "is_in_fit_range",
]

QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole DN (EMVA 1288 release 4.0, section 2.4)."""

FIT_TOP = 0.7
"""Share of the range from black to saturation that is fitted (EMVA 1288, section 6.4)."""

MOST_CLIPPED = 0.002
"""Share of clipped pixels above which a flat is left out."""

FEWEST_LEVELS = 3
_SAME_LEVEL = 0.02
_SIGNIFICANT = 3.0
_ROUNDS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelSample:
    """One dark or flat capture, averaged over its pixels.

    ``variance_dn2`` is the mean over pixels of the unbiased temporal variance of one frame.
    """

    kind: Literal["dark", "flat"]
    name: str
    mean_dn: float
    variance_dn2: float
    pixels: int
    frames: int
    exposure_us: float | None
    time_s: float
    clipped_fraction: float = 0.0

    def __post_init__(self) -> None:
        if self.frames < 2 or self.pixels < 1:
            raise ValueError(
                f"a variance needs 2 frames and a pixel, got {self.frames} and {self.pixels}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Saturation:
    """The level at which pixels clip; ``err_dn`` is None where no capture reached it."""

    level_dn: float
    err_dn: float | None

    @property
    def is_reached(self) -> bool:
        """Whether it was seen, rather than taken from the pixel format."""
        return self.err_dn is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotonTransfer:
    """What dark and flat captures tell about a camera at one gain; errors are standard errors.

    Electrons are those of the linear camera model. ``light_flicker`` is the relative change of
    the light from frame to frame where the curve shows any, else 0. ``chi2_reduced`` compares
    the scatter about the line with what the number of pixels allows; where it is above 1, the
    errors are widened by its root.
    """

    gain_e_per_dn: float
    gain_e_per_dn_err: float
    read_noise_e: float
    read_noise_e_err: float
    dark: DarkSignal
    saturation: Saturation
    linearity: Linearity | None
    light_flicker: float
    fit_low_dn: float
    fit_high_dn: float
    chi2_reduced: float
    offset_dn2: float
    slope_dn: float
    curvature: float
    samples: tuple[LevelSample, ...]
    fitted: tuple[bool, ...]
    notes: tuple[str, ...] = ()

    @property
    def saturation_e(self) -> float:
        """Electrons at saturation."""
        return self.gain_e_per_dn * (self.saturation.level_dn - self.dark.black_level_dn)

    def variance_dn2(self, light_dn: NDArray[np.float64]) -> NDArray[np.float64]:
        """The fitted variance of one frame at a level above black."""
        return self.offset_dn2 + self.slope_dn * light_dn + self.curvature * light_dn**2


def fit_photon_transfer(samples: Sequence[LevelSample], saturation: Saturation) -> PhotonTransfer:
    """Fit the photon transfer line to dark and flat captures.

    The variance of one frame is ``v0 + K x`` with x the level above black: K is DN per electron
    and ``v0 - 1/12`` the read noise squared. Each capture is weighted by the variance of its
    variance, ``2 v^2 / ((N - 1) pixels)``, taken from the fitted line. Light that flickers adds
    ``c x^2``: that term is fitted too where it stands out by three standard errors.

    Parameters
    ----------
    samples
        At least one dark capture, and flats of three levels in the fitted range.
    saturation
        Where pixels clip.

    Raises
    ------
    NoiseError
        If a kind or levels are missing; the message says what to capture.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, sections 2.4, 6.4 and 6.5.
    """
    darks = [sample for sample in samples if sample.kind == "dark"]
    flats = [sample for sample in samples if sample.kind == "flat"]
    if not darks:
        raise NoiseError("no dark capture: put the lens cap on and capture kind dark, too")
    if not flats:
        raise NoiseError("no flat capture: capture an even white surface at several exposures")
    dark = dark_signal(darks)
    fitted = [
        sample.kind == "dark" or is_in_fit_range(sample, dark.black_level_dn, saturation.level_dn)
        for sample in samples
    ]
    used = [sample for sample, is_used in zip(samples, fitted, strict=True) if is_used]
    # Electrons of the dark current are shot noise like any other: black is that of exposure 0.
    light_dn = np.array([sample.mean_dn for sample in used]) - dark.black_level_dn
    is_flat = np.array([sample.kind == "flat" for sample in used])
    _require_levels(light_dn[is_flat], flats)
    variance_dn2 = np.array([sample.variance_dn2 for sample in used])
    spread = np.array([2.0 / ((sample.frames - 1) * sample.pixels) for sample in used])
    line = _fit(light_dn, variance_dn2, spread, order=1)
    notes = list(dark.notes)
    flicker = 0.0
    if len(used) > FEWEST_LEVELS + 1:
        curve = _fit(light_dn, variance_dn2, spread, order=2)
        curvature, curvature_err = curve.values[2], float(np.sqrt(curve.covariance[2, 2]))
        if abs(curvature) > _SIGNIFICANT * curvature_err and curve.values[1] > 0:
            line = curve
            flicker = float(np.sqrt(max(curvature, 0.0)))
            notes.append(_curvature_note(curvature, flicker))
    offset, slope = float(line.values[0]), float(line.values[1])
    if slope <= _SIGNIFICANT * float(np.sqrt(line.covariance[1, 1])):
        raise NoiseError(
            "the variance does not rise with the light: the flats tell no gain "
            "(a processed picture, or flats of one brightness?)"
        )
    read_dn2 = offset - QUANTISATION_DN2
    if read_dn2 <= 0:
        notes.append("the read noise is below what the rounding to whole DN lets through")
    read_dn2 = max(read_dn2, 0.0)
    gain, read_e = 1.0 / slope, float(np.sqrt(read_dn2)) / slope
    # d read / d v0 = gain / (2 sqrt), d read / d K = -read gain
    toward = np.zeros(line.values.size)
    toward[0] = gain / (2.0 * np.sqrt(max(read_dn2, float(np.sqrt(line.covariance[0, 0])))))
    toward[1] = -read_e * gain
    if not saturation.is_reached:
        notes.append(
            "no flat saturates: saturation is taken from the pixel format; expose longer to see it"
        )
    lit = light_dn[is_flat]
    return PhotonTransfer(
        gain_e_per_dn=gain,
        gain_e_per_dn_err=gain**2 * float(np.sqrt(line.covariance[1, 1])),
        read_noise_e=read_e,
        read_noise_e_err=float(np.sqrt(toward @ line.covariance @ toward)),
        dark=dark.in_electrons(gain),
        saturation=saturation,
        linearity=measure_linearity(
            [
                (
                    sample.exposure_us,
                    sample.time_s,
                    sample.mean_dn - dark.level_dn(sample.exposure_us),
                )
                for sample in flats
                if sample.exposure_us is not None and sample.clipped_fraction <= MOST_CLIPPED
            ],
            range_dn=saturation.level_dn - dark.black_level_dn,
        ),
        light_flicker=flicker,
        fit_low_dn=float(lit.min() + dark.black_level_dn),
        fit_high_dn=float(lit.max() + dark.black_level_dn),
        chi2_reduced=line.chi2_reduced,
        offset_dn2=offset,
        slope_dn=slope,
        curvature=float(line.values[2]) if line.values.size == 3 else 0.0,
        samples=tuple(samples),
        fitted=tuple(fitted),
        notes=tuple(notes),
    )


def is_in_fit_range(sample: LevelSample, black_level_dn: float, saturation_dn: float) -> bool:
    """Whether a flat lies low enough to be fitted, and is not clipped."""
    top_dn = black_level_dn + FIT_TOP * (saturation_dn - black_level_dn)
    return black_level_dn < sample.mean_dn <= top_dn and sample.clipped_fraction <= MOST_CLIPPED


def _require_levels(light_dn: NDArray[np.float64], flats: Sequence[LevelSample]) -> None:
    levels: list[float] = []
    for light in np.sort(light_dn):
        if not levels or light > (1 + _SAME_LEVEL) * levels[-1]:
            levels.append(float(light))
    if len(levels) >= FEWEST_LEVELS:
        return
    clipped = sum(sample.clipped_fraction > MOST_CLIPPED for sample in flats)
    remedy = "expose shorter" if clipped else "capture flats at more exposures"
    raise NoiseError(
        f"{len(levels)} usable level{'s' * (len(levels) != 1)} of {len(flats)} flats "
        f"({clipped} saturated): {FEWEST_LEVELS} below {FIT_TOP:.0%} of saturation are needed; "
        f"{remedy}"
    )


def _curvature_note(curvature: float, flicker: float) -> str:
    if curvature > 0:
        return (
            f"the light flickers by {100 * flicker:.2f} % from frame to frame; its share of the "
            "variance was fitted and left out of the gain"
        )
    return "the variance bends down with the level (a camera that is not linear); see the curve"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Polynomial:
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]
    chi2_reduced: float


def _fit(
    light_dn: NDArray[np.float64],
    variance_dn2: NDArray[np.float64],
    spread: NDArray[np.float64],
    order: int,
) -> _Polynomial:
    """Weighted polynomial; weights follow the fitted curve, never the scattered values."""
    scale = max(float(light_dn.max()), 1.0)
    design = (light_dn[:, None] / scale) ** np.arange(order + 1)
    floor = 1e-6 * max(float(variance_dn2.max()), 1e-12)
    expected = np.maximum(variance_dn2, floor)
    values = np.zeros(order + 1)
    normal = np.eye(order + 1)
    for _ in range(_ROUNDS):
        err = expected * np.sqrt(spread)
        weighted = design / err[:, None]
        normal = weighted.T @ weighted
        values = np.linalg.solve(normal, weighted.T @ (variance_dn2 / err))
        expected = np.maximum(design @ values, floor)
    residual = (variance_dn2 - design @ values) / (expected * np.sqrt(spread))
    freedom = light_dn.size - order - 1
    chi2 = float(residual @ residual) / freedom if freedom > 0 else 1.0
    units = scale ** -np.arange(order + 1.0)
    covariance = np.linalg.inv(normal) * max(chi2, 1.0)
    return _Polynomial(
        values=values * units, covariance=covariance * np.outer(units, units), chi2_reduced=chi2
    )
