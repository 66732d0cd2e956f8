"""Photon transfer by EMVA 1288: gain, read noise, black level, linearity, saturation."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from acquisition.files import StoredModel
from calibration.errors import NoiseError
from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise
from simulation.palette import BLUE, GREEN, INK, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIGNIFICANT = 3.0
_US_PER_S = 1e6
_CLEAR_OF_ZERO = 3.0


class _DarkSample(Protocol):
    """A dark capture, averaged over its pixels."""

    @property
    def mean_dn(self) -> float:
        """Mean level."""
        ...

    @property
    def variance_dn2(self) -> float:
        """Temporal variance of one frame."""
        ...

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        ...

    @property
    def frames(self) -> int:
        """Number of frames averaged."""
        ...

    @property
    def exposure_us(self) -> float | None:
        """Exposure time."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class _DarkSignal:
    """Level without light: the black level at exposure 0, rising with the dark current.

    ``rate_dn_per_us`` is 0 if the dark captures show no dark current; ``current_e_per_s``
    is None until the gain is known, and if there are too few exposures to measure it.
    """

    black_level_dn: float
    black_level_dn_err: float
    rate_dn_per_us: float = 0.0
    rate_err_dn_per_us: float | None = None
    measured_rate_dn_per_us: float = 0.0
    current_e_per_s: float | None = None
    current_e_per_s_err: float | None = None
    notes: tuple[str, ...] = field(default=())

    def level_dn(self, exposure_us: float | None) -> float:
        """Level without light at an exposure."""
        return self.black_level_dn + self.rate_dn_per_us * (exposure_us or 0.0)

    def in_electrons(self, gain_e_per_dn: float) -> "_DarkSignal":
        """The same signal with the dark current in electrons."""
        if self.rate_err_dn_per_us is None:
            return self
        unit = gain_e_per_dn * _US_PER_S
        return replace(
            self,
            current_e_per_s=self.measured_rate_dn_per_us * unit,
            current_e_per_s_err=self.rate_err_dn_per_us * unit,
        )


def _dark_signal(darks: Sequence[_DarkSample]) -> _DarkSignal:
    """Measure the black level, and the dark current if exposures differ.

    The error is the larger of those from the temporal noise and from the captures' scatter.
    """
    level = np.array([sample.mean_dn for sample in darks])
    temporal = np.array(
        [np.sqrt(sample.variance_dn2 / (sample.frames * sample.pixels)) for sample in darks]
    )
    notes = _clipping_notes(darks)
    err = float(np.sqrt(np.sum(temporal**2)) / level.size)
    if level.size > 1:
        err = max(err, float(level.std(ddof=1) / np.sqrt(level.size)))
    steady = _DarkSignal(black_level_dn=float(level.mean()), black_level_dn_err=err, notes=notes)
    exposures = [sample.exposure_us for sample in darks]
    known = np.array([value for value in exposures if value is not None])
    if known.size < max(level.size, 3) or np.ptp(known) == 0:
        return steady
    design = np.stack([np.ones_like(known), known / known.max()], axis=1)
    values, *_ = np.linalg.lstsq(design, level, rcond=None)
    left = level - design @ values
    scatter = float(np.sqrt(left @ left / (level.size - 2)))
    covariance = np.linalg.inv(design.T @ design) * max(scatter, float(temporal.max())) ** 2
    rate, rate_err = float(values[1] / known.max()), float(np.sqrt(covariance[1, 1]) / known.max())
    if rate <= _SIGNIFICANT * rate_err:
        return replace(steady, rate_err_dn_per_us=rate_err, measured_rate_dn_per_us=rate)
    return _DarkSignal(
        black_level_dn=float(values[0]),
        black_level_dn_err=float(np.sqrt(covariance[0, 0])),
        rate_dn_per_us=rate,
        rate_err_dn_per_us=rate_err,
        measured_rate_dn_per_us=rate,
        notes=notes,
    )


def _clipping_notes(darks: Sequence[_DarkSample]) -> tuple[str, ...]:
    low = [
        sample for sample in darks if sample.mean_dn < _CLEAR_OF_ZERO * np.sqrt(sample.variance_dn2)
    ]
    if not low:
        return ()
    return (
        "the dark level is so low that its noise is clipped at 0, and the read noise comes out too "
        "small; raise the camera's BlackLevel",
    )


LOW, HIGH = 0.05, 0.95
"""Range of levels, as a share of saturation (EMVA 1288 release 4.0, section 6.7)."""

_FEWEST_LEVELS = 3
_LATER_S = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearity:
    """Relative deviations of the level from a straight line over the exposure.

    ``light_drift_per_s`` is the relative change of the light, None if no exposure was captured
    twice.
    """

    mean_deviation: float
    worst_deviation: float
    exposures_us: tuple[float, ...]
    light_dn: tuple[float, ...]
    deviations: tuple[float, ...]
    light_drift_per_s: float | None


def _measure_linearity(
    levels: Sequence[tuple[float, float, float]], *, range_dn: float
) -> Linearity | None:
    """Fit a line to level over exposure, with relative weights.

    If exposures were captured more than once, a steady drift of the light is fitted and removed;
    otherwise it counts as deviation. Levels are exposure in us, time in s and level above black in
    DN of each flat. None if fewer than three exposures are between 5 and 95 % of saturation.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 6.7: the linearity error is the mean
    of the absolute relative deviations.
    """
    kept = [entry for entry in levels if LOW * range_dn <= entry[2] <= HIGH * range_dn]
    if len({exposure for exposure, _, _ in kept}) < _FEWEST_LEVELS:
        return None
    exposure, time, light = (np.array(column) for column in zip(*kept, strict=True))
    unit = exposure / exposure.max()
    columns = [unit, np.ones_like(unit)]
    elapsed = time - time.min()
    has_drift = _is_repeated(exposure, elapsed) and exposure.size > _FEWEST_LEVELS + 1
    if has_drift:
        columns.append(unit * elapsed / elapsed.max())
    design = np.stack(columns, axis=1)
    values, *_ = np.linalg.lstsq(design / light[:, None], np.ones_like(light), rcond=None)
    deviation = light / (design @ values) - 1.0
    return Linearity(
        mean_deviation=float(np.mean(np.abs(deviation))),
        worst_deviation=float(np.max(np.abs(deviation))),
        exposures_us=tuple(exposure.tolist()),
        light_dn=tuple(light.tolist()),
        deviations=tuple(deviation.tolist()),
        light_drift_per_s=float(values[2] / values[0] / elapsed.max()) if has_drift else None,
    )


def _is_repeated(exposure: np.ndarray, elapsed: np.ndarray) -> bool:
    return any(
        float(np.ptp(elapsed[exposure == value])) > _LATER_S for value in np.unique(exposure)
    )


QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole DN (EMVA 1288 release 4.0, section 2.4)."""

FIT_TOP = 0.7
"""Fraction of the range from black to saturation that is fitted (EMVA 1288, section 6.4)."""

MOST_CLIPPED = 0.002
"""Fraction of clipped pixels above which a flat is left out."""

FEWEST_LEVELS = 3
_SAME_LEVEL = 0.02
_ROUNDS = 5


class LevelSample(StoredModel):
    """One dark or flat capture, averaged over its pixels.

    ``variance_dn2`` is the mean over pixels of the unbiased temporal variance of one frame,
    ``is_fitted`` says whether the photon transfer line was fitted to it. ``time_s``, by any clock,
    is not stored in the file.
    """

    kind: Literal["dark", "flat"]
    capture: str
    exposure_us: float | None
    mean_dn: float
    variance_dn2: float
    pixels: int = Field(ge=1)
    frames: int = Field(ge=2)
    clipped_fraction: float = 0.0
    is_fitted: bool = False
    time_s: float = Field(default=0.0, exclude=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Saturation:
    """The level at which pixels clip; ``err_dn`` is None if no capture reached it."""

    level_dn: float
    err_dn: float | None

    @property
    def is_reached(self) -> bool:
        """Whether it was observed, rather than taken from the pixel format."""
        return self.err_dn is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotonTransfer:
    """What dark and flat captures say about a camera at one gain; errors are standard errors.

    Electrons are those of the linear camera model. ``light_flicker`` is the relative change of
    the light from frame to frame if the curve shows any, otherwise 0. ``chi2_reduced`` compares
    the scatter about the line with that expected from the number of pixels; if it is above 1, the
    errors are multiplied by its square root.
    """

    gain_e_per_dn: float
    gain_e_per_dn_err: float
    read_noise_e: float
    read_noise_e_err: float
    dark: _DarkSignal
    saturation: Saturation
    linearity: Linearity | None
    light_flicker: float
    fit_low_dn: float
    fit_high_dn: float
    chi2_reduced: float
    offset_dn2: float
    slope_dn: float
    curvature: float
    samples: tuple[LevelSample, ...] = field(repr=False)
    notes: tuple[str, ...] = ()

    @property
    def saturation_e(self) -> float:
        """Number of electrons at saturation."""
        return self.gain_e_per_dn * (self.saturation.level_dn - self.dark.black_level_dn)

    def variance_dn2(self, light_dn: FloatArray) -> FloatArray:
        """The fitted variance of one frame at a level above black."""
        return self.offset_dn2 + self.slope_dn * light_dn + self.curvature * light_dn**2


def fit_photon_transfer(
    samples: Sequence[LevelSample],
    saturation: Saturation,
    quantisation_dn2: float = QUANTISATION_DN2,
) -> PhotonTransfer:
    """Fit the photon transfer line to dark and flat captures.

    The variance of one frame is ``v0 + K x`` with x the level above black: K is DN per electron and
    ``v0`` less that of rounding the read noise squared. Each capture is weighted by the variance of
    its variance, ``2 v^2 / ((N - 1) pixels)``, taken from the fitted line. Flickering light adds
    ``c x^2``: that term is fitted too if it exceeds three standard errors. It takes a dark capture,
    and flats at three levels in the fitted range; the quantisation is a twelfth of the squared
    step.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, sections 2.4, 6.4 and 6.5.
    """
    darks = [sample for sample in samples if sample.kind == "dark"]
    flats = [sample for sample in samples if sample.kind == "flat"]
    if not darks:
        raise NoiseError(
            "no dark capture: put the lens cap on and capture with kind dark too", reason="no_dark"
        )
    if not flats:
        raise NoiseError(
            "no flat capture: capture an evenly lit white surface at several exposures",
            reason="no_flat",
        )
    dark = _dark_signal(darks)
    _refuse_exchanged(darks, flats)
    marked = tuple(_marked(sample, dark.black_level_dn, saturation.level_dn) for sample in samples)
    lit_dn = _require_levels(marked, dark.black_level_dn)
    fitted = [sample for sample in marked if sample.is_fitted]
    line = _line(fitted, dark.black_level_dn, quantisation_dn2)
    notes = (*dark.notes, *_notes(line))
    if not saturation.is_reached:
        notes = (
            *notes,
            "no flat saturates, so saturation is taken from the pixel format; "
            "expose longer to measure it",
        )
    return PhotonTransfer(
        gain_e_per_dn=line.gain_e_per_dn,
        gain_e_per_dn_err=line.gain_e_per_dn**2 * line.err(1),
        read_noise_e=line.read_noise_e,
        read_noise_e_err=line.read_noise_e_err,
        dark=dark.in_electrons(line.gain_e_per_dn),
        saturation=saturation,
        linearity=_linearity(flats, dark, saturation),
        light_flicker=line.light_flicker,
        fit_low_dn=float(lit_dn.min() + dark.black_level_dn),
        fit_high_dn=float(lit_dn.max() + dark.black_level_dn),
        chi2_reduced=line.chi2_reduced,
        offset_dn2=line.offset_dn2,
        slope_dn=line.slope_dn,
        curvature=line.curvature,
        samples=marked,
        notes=notes,
    )


def _refuse_exchanged(darks: Sequence[LevelSample], flats: Sequence[LevelSample]) -> None:
    brightest_dn = max(sample.mean_dn for sample in flats)
    if min(sample.mean_dn for sample in darks) >= brightest_dn:
        raise NoiseError(
            f"no flat (the brightest at {brightest_dn:.0f} DN) is brighter than the darks: they "
            "have been swapped, or no light reached the flats",
            reason="levels",
        )


def is_in_fit_range(sample: LevelSample, black_level_dn: float, saturation_dn: float) -> bool:
    """Whether a flat's level is low enough to be fitted, and it is not clipped."""
    top_dn = black_level_dn + FIT_TOP * (saturation_dn - black_level_dn)
    return black_level_dn < sample.mean_dn <= top_dn and sample.clipped_fraction <= MOST_CLIPPED


def _marked(sample: LevelSample, black_level_dn: float, saturation_dn: float) -> LevelSample:
    is_fitted = sample.kind == "dark" or is_in_fit_range(sample, black_level_dn, saturation_dn)
    return sample.model_copy(update={"is_fitted": is_fitted})


def _require_levels(samples: Sequence[LevelSample], black_level_dn: float) -> FloatArray:
    """Levels above black of the flats to fit; there must be three different levels."""
    flats = [sample for sample in samples if sample.kind == "flat"]
    lit_dn = np.array([flat.mean_dn for flat in flats if flat.is_fitted]) - black_level_dn
    levels: list[float] = []
    for light in np.sort(lit_dn):
        if not levels or light > (1 + _SAME_LEVEL) * levels[-1]:
            levels.append(float(light))
    if len(levels) >= FEWEST_LEVELS:
        return lit_dn
    clipped = sum(flat.clipped_fraction > MOST_CLIPPED for flat in flats)
    remedy = "shorten the exposure" if clipped else "capture flats at more exposures"
    raise NoiseError(
        f"{len(levels)} usable level{'s' * (len(levels) != 1)} in {len(flats)} flats "
        f"({clipped} saturated): {FEWEST_LEVELS} below {FIT_TOP:.0%} of saturation are needed; "
        f"{remedy}",
        reason="levels",
        saturated=clipped,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Line:
    """Variance of one frame against the light level, a polynomial of order 1 or 2."""

    values: FloatArray
    covariance: FloatArray
    chi2_reduced: float
    quantisation_dn2: float

    @property
    def offset_dn2(self) -> float:
        return float(self.values[0])

    @property
    def slope_dn(self) -> float:
        return float(self.values[1])

    @property
    def curvature(self) -> float:
        return float(self.values[2]) if self.values.size == 3 else 0.0

    @property
    def gain_e_per_dn(self) -> float:
        return 1.0 / self.slope_dn

    @property
    def light_flicker(self) -> float:
        return float(np.sqrt(max(self.curvature, 0.0)))

    @property
    def read_dn2(self) -> float:
        return max(self.offset_dn2 - self.quantisation_dn2, 0.0)

    @property
    def read_noise_e(self) -> float:
        return float(np.sqrt(self.read_dn2)) / self.slope_dn

    @property
    def read_noise_e_err(self) -> float:
        # d read / d v0 = gain / (2 sqrt), d read / d K = -read gain
        toward = np.zeros(self.values.size)
        toward[0] = self.gain_e_per_dn / (2.0 * np.sqrt(max(self.read_dn2, self.err(0))))
        toward[1] = -self.read_noise_e * self.gain_e_per_dn
        return float(np.sqrt(toward @ self.covariance @ toward))

    def err(self, order: int) -> float:
        """Standard error of a coefficient."""
        return float(np.sqrt(self.covariance[order, order]))


def _line(samples: Sequence[LevelSample], black_level_dn: float, quantisation_dn2: float) -> _Line:
    """The straight line, or the curve if its bend exceeds three standard errors."""
    # Dark current adds shot noise as light does: the black level is that at exposure 0.
    light_dn = np.array([sample.mean_dn for sample in samples]) - black_level_dn
    variance_dn2 = np.array([sample.variance_dn2 for sample in samples])
    spread = np.array([2.0 / ((sample.frames - 1) * sample.pixels) for sample in samples])
    line = _fit(light_dn, variance_dn2, spread, order=1, quantisation_dn2=quantisation_dn2)
    if len(samples) > FEWEST_LEVELS + 1:
        curve = _fit(light_dn, variance_dn2, spread, order=2, quantisation_dn2=quantisation_dn2)
        if abs(curve.curvature) > _SIGNIFICANT * curve.err(2) and curve.slope_dn > 0:
            line = curve
    if line.slope_dn <= _SIGNIFICANT * line.err(1):
        raise NoiseError(
            "the variance does not rise with the light, so the flats do not determine the gain "
            "(are the images processed, or the flats all equally bright?)",
            reason="no_gain",
        )
    return line


def _notes(line: _Line) -> Iterator[str]:
    if line.curvature > 0:
        yield (
            f"the light flickers by {100 * line.light_flicker:.2f} % from frame to frame; its "
            "contribution to the variance was fitted and left out of the gain"
        )
    elif line.curvature < 0:
        yield "the variance bends down with the level (a nonlinear camera); see the curve"
    if line.offset_dn2 <= line.quantisation_dn2:
        yield "the read noise is below the rounding to whole DN and cannot be measured"


def _linearity(
    flats: Sequence[LevelSample], dark: _DarkSignal, saturation: Saturation
) -> Linearity | None:
    levels = [
        (flat.exposure_us, flat.time_s, flat.mean_dn - dark.level_dn(flat.exposure_us))
        for flat in flats
        if flat.exposure_us is not None and flat.clipped_fraction <= MOST_CLIPPED
    ]
    return _measure_linearity(levels, range_dn=saturation.level_dn - dark.black_level_dn)


def _fit(
    light_dn: FloatArray,
    variance_dn2: FloatArray,
    spread: FloatArray,
    *,
    order: int,
    quantisation_dn2: float,
) -> _Line:
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
    return _Line(
        values=values * units,
        covariance=covariance * np.outer(units, units),
        chi2_reduced=chi2,
        quantisation_dn2=quantisation_dn2,
    )


def draw_photon_transfer(axes: "Axes", transfer: PhotonTransfer) -> None:
    """Draw the variance of a frame against the light, with the fit and the saturation."""
    black = transfer.dark.black_level_dn
    light = np.array([sample.mean_dn - black for sample in transfer.samples])
    variance = np.array([sample.variance_dn2 for sample in transfer.samples])
    fitted = np.array([sample.is_fitted for sample in transfer.samples])
    line = np.linspace(0, light.max(), 200)
    axes.plot(line, transfer.variance_dn2(line), color=INK, linewidth=1, label="fit")
    axes.plot(light[fitted], variance[fitted], "o", markersize=4, color=BLUE, label="fitted")
    if not fitted.all():
        axes.plot(
            light[~fitted], variance[~fitted], "o", markersize=4, markerfacecolor="white",
            color=VERMILION, label="not fitted",
        )  # fmt: skip
    axes.axvline(
        transfer.saturation.level_dn - black, color=GREEN, linewidth=1, linestyle="--",
        label="saturation",
    )  # fmt: skip
    axes.set(ylabel="variance of one frame / DN²", ylim=(0, None))
    axes.legend(loc="upper left", fontsize=8)


_BINS = 64
_WEIGHTING_ROUNDS = 4
_QUANTISATION_DN2 = 1.0 / 12.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelNoise:
    """Variance of one pixel value: ``offset_dn2 + slope_dn * level``, at least ``floor_dn2``.

    EMVA 1288 release 4.0, section 2.4: the photon transfer line.
    """

    offset_dn2: float
    slope_dn: float
    floor_dn2: float

    def __post_init__(self) -> None:
        if not self.floor_dn2 > 0:
            raise ValueError(f"floor_dn2 must be positive, got {self.floor_dn2}")

    def variance_dn2(self, level_dn: FloatArray) -> FloatArray:
        """Variance at each level, in DN^2."""
        return np.maximum(self.offset_dn2 + self.slope_dn * level_dn, self.floor_dn2)

    def averaged(self, frames: int) -> "LevelNoise":
        """The noise of a mean over ``frames`` frames."""
        return LevelNoise(
            offset_dn2=self.offset_dn2 / frames,
            slope_dn=self.slope_dn / frames,
            floor_dn2=self.floor_dn2 / frames,
        )


def level_noise(noise: CaptureNoise) -> LevelNoise:
    """Return the noise of a single frame, including rounding, from a camera's noise.json."""
    dark_dn2 = (noise.read_noise_e / noise.gain_e_per_dn) ** 2 + _QUANTISATION_DN2
    slope_dn = 1.0 / noise.gain_e_per_dn
    return LevelNoise(
        offset_dn2=dark_dn2 - slope_dn * noise.black_level_dn,
        slope_dn=slope_dn,
        floor_dn2=dark_dn2,
    )


def fit_level_noise(
    mean_dn: NDArray[np.floating], variance_dn2: NDArray[np.floating], saturation_dn: float
) -> LevelNoise:
    """Fit the photon transfer line to the temporal variance of single frames.

    Pixels above 98 % of the saturation are left out, as their variance is clipped; 100 must be
    left.
    """
    mean = np.asarray(mean_dn, dtype=np.float64).ravel()
    variance = np.asarray(variance_dn2, dtype=np.float64).ravel()
    kept = mean < 0.98 * saturation_dn
    mean, variance = mean[kept], variance[kept]
    if mean.size < 100:
        raise ValueError(f"the noise line needs 100 unsaturated pixels, got {mean.size}")
    edges = np.linspace(mean.min(), mean.max() * (1 + 1e-12) + 1e-12, _BINS + 1)
    index = np.clip(np.searchsorted(edges, mean, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(index, minlength=_BINS)
    used = count > 0
    level = np.bincount(index, mean, minlength=_BINS)[used] / count[used]
    spread = np.bincount(index, variance, minlength=_BINS)[used] / count[used]
    count = count[used]
    # The scatter of a mean variance is proportional to it: weight by the fitted line.
    floor = max(1e-3 * float(np.mean(variance)), 1e-12)
    fitted = np.full(level.size, max(float(np.mean(variance)), floor))
    offset, slope = float(np.mean(variance)), 0.0
    for _ in range(_WEIGHTING_ROUNDS):
        weight = count / fitted**2
        centre = np.average(level, weights=weight)
        moment = np.sum(weight * (level - centre) ** 2)
        if moment > 0:
            slope = float(np.sum(weight * (level - centre) * spread) / moment)
        offset = float(np.average(spread, weights=weight) - slope * centre)
        fitted = np.maximum(offset + slope * level, floor)
    return LevelNoise(offset_dn2=offset, slope_dn=slope, floor_dn2=floor)
