"""The data sheet of EMVA 1288, linear model, of a camera whose light is not calibrated.

Without the number of photons there is no quantum efficiency: everything that the standard gives in
photons stands here in electrons, which differ from them by that factor.

References
----------
EMVA Standard 1288, release 4.0 linear, 2021, sections 2, 3 and 9 (summary data sheet).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, log, log2, log10, sqrt

from calibration.estimate import NORMAL_95, with_reach
from calibration.noise._pattern import PatternParts
from calibration.noise._photon_transfer import PhotonTransfer


@dataclass(frozen=True, slots=True, kw_only=True)
class EmvaRow:
    """A line of the data sheet: what it is, the standard's symbol, the value and its unit.

    ``key`` is its name in a table; a figure in two units has two lines. ``err`` is a standard
    error, None where it is not known.
    """

    key: str
    name: str
    symbol: str
    value: float
    unit: str
    err: float | None = None
    digits: int = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class EmvaSheet:
    """Figures of the data sheet; standard errors end in ``_err``.

    ``system_gain_dn_per_e``: K. ``dark_noise_e``: temporal noise in the dark, of the camera without
    that of rounding. ``threshold_e``: signal with an SNR of 1. ``dsnu_e``, ``prnu``: fixed pattern
    in the dark and of the response, the latter over the mean. ``dark_current_e_per_s``,
    ``linearity_error``: None where the captures do not tell. ``is_saturated``: whether a flat
    reached saturation; else it is the largest level of the format, and what follows from it has no
    error.
    """

    system_gain_dn_per_e: float
    system_gain_err_dn_per_e: float
    dark_noise_e: float
    dark_noise_err_e: float
    dark_noise_dn: float
    saturation_e: float
    saturation_err_e: float | None
    is_saturated: bool
    threshold_e: float
    dsnu_e: PatternParts
    prnu: PatternParts
    dark_current_e_per_s: float | None
    dark_current_err_e_per_s: float | None
    linearity_error: float | None

    @property
    def snr_max(self) -> float:
        """Signal-to-noise ratio at saturation, where shot noise is all."""
        return sqrt(self.saturation_e)

    @property
    def snr_max_db(self) -> float:
        """The same in decibels."""
        return 20 * log10(self.snr_max)

    @property
    def snr_max_err_db(self) -> float | None:
        """Standard error of that; None if no flat reached saturation."""
        if self.saturation_err_e is None:
            return None
        return 10 / log(10) * self.saturation_err_e / self.saturation_e

    @property
    def dynamic_range(self) -> float:
        """Saturation over the absolute sensitivity threshold."""
        return self.saturation_e / self.threshold_e

    @property
    def dynamic_range_db(self) -> float:
        """The same in decibels."""
        return 20 * log10(self.dynamic_range)

    @property
    def dynamic_range_err_db(self) -> float | None:
        """Standard error of the dynamic range in decibels; None if no flat reached saturation."""
        if self.saturation_err_e is None:
            return None
        relative = hypot(
            self.saturation_err_e / self.saturation_e, self.dark_noise_err_e / self.threshold_e
        )
        return 20 / log(10) * relative

    @property
    def dynamic_range_text(self) -> str:
        """The same with its 95 % interval, or where saturation is from if no flat reached it."""
        if self.dynamic_range_err_db is None:
            return f"{self.dynamic_range_db:.1f} dB, saturation from the pixel format"
        return f"{with_reach(self.dynamic_range_db, NORMAL_95 * self.dynamic_range_err_db, 1)} dB"

    @property
    def dynamic_range_bits(self) -> float:
        """The same in bits."""
        return log2(self.dynamic_range)

    def rows(self) -> Iterator[EmvaRow]:
        """Yield the lines of the data sheet, in the standard's order."""
        seen = "" if self.is_saturated else ", saturation from the pixel format"
        yield EmvaRow(
            key="system_gain", name="overall system gain", symbol="K", unit="DN/e", digits=4,
            value=self.system_gain_dn_per_e, err=self.system_gain_err_dn_per_e,
        )  # fmt: skip
        yield EmvaRow(
            key="dark_noise", name="temporal dark noise", symbol="σ_d", unit="e",
            value=self.dark_noise_e, err=self.dark_noise_err_e,
        )  # fmt: skip
        yield EmvaRow(
            key="dark_noise_with_rounding", name="temporal dark noise, with rounding",
            symbol="σ_y.dark", unit="DN", value=self.dark_noise_dn, digits=3,
        )  # fmt: skip
        yield EmvaRow(
            key="snr_max", name=f"signal-to-noise ratio, maximum{seen}", symbol="SNR_max",
            unit="dB", value=self.snr_max_db, err=self.snr_max_err_db,
        )  # fmt: skip
        yield EmvaRow(key="snr_max", name="", symbol="", value=log2(self.snr_max), unit="bits")
        yield EmvaRow(
            key="threshold", name="absolute sensitivity threshold", symbol="μ_e.min", unit="e",
            value=self.threshold_e, err=self.dark_noise_err_e,
        )  # fmt: skip
        yield EmvaRow(
            key="saturation", name=f"saturation capacity{seen.replace(' saturation', '')}",
            symbol="μ_e.sat", unit="e", value=self.saturation_e, err=self.saturation_err_e,
            digits=0,
        )  # fmt: skip
        yield EmvaRow(
            key="dynamic_range", name=f"dynamic range{seen}", symbol="DR", unit="dB",
            value=self.dynamic_range_db, err=self.dynamic_range_err_db,
        )  # fmt: skip
        yield EmvaRow(
            key="dynamic_range", name="", symbol="", value=self.dynamic_range_bits, unit="bits"
        )
        yield from _pattern_rows(_DSNU, self.dsnu_e)
        yield from _pattern_rows(_PRNU, self.prnu.scaled(100.0))
        if self.linearity_error is not None:
            yield EmvaRow(
                key="linearity_error", name="linearity error", symbol="LE", unit="%",
                value=100 * self.linearity_error, digits=3,
            )  # fmt: skip
        if self.dark_current_e_per_s is not None:
            yield EmvaRow(
                key="dark_current", name="dark current", symbol="μ_c.mean", unit="e/s",
                value=self.dark_current_e_per_s, err=self.dark_current_err_e_per_s,
            )  # fmt: skip


_DSNU = ("dsnu", "dark signal nonuniformity", "DSNU_1288", "e")
_PRNU = ("prnu", "photo response nonuniformity", "PRNU_1288", "%")


def _pattern_rows(what: tuple[str, str, str, str], parts: PatternParts) -> Iterator[EmvaRow]:
    key, name, symbol, unit = what
    yield EmvaRow(
        key=key, name=name, symbol=symbol, value=parts.total, unit=unit, err=parts.err, digits=3
    )
    for part, end, value in (
        ("rows", ".row", parts.rows),
        ("columns", ".col", parts.columns),
        ("pixels", ".pixel", parts.pixels),
    ):
        yield EmvaRow(
            key=f"{key}_of_{part}", name=f"of {part}", symbol=f"{symbol}{end}", value=value,
            unit=unit, digits=3,
        )  # fmt: skip


def emva_sheet(transfer: PhotonTransfer, dsnu_dn: PatternParts, prnu: PatternParts) -> EmvaSheet:
    """Return the data sheet of a photon transfer curve and of the sensor's patterns."""
    gain, gain_err = transfer.gain_e_per_dn, transfer.gain_e_per_dn_err
    saturation, dark, linearity = transfer.saturation, transfer.dark, transfer.linearity
    dark_dn = sqrt(max(transfer.offset_dn2, 0.0))  # with the rounding, of whatever step
    saturation_err_e = None
    if saturation.err_dn is not None:
        saturation_err_e = hypot(transfer.saturation_e * gain_err / gain, gain * saturation.err_dn)
    return EmvaSheet(
        system_gain_dn_per_e=1 / gain,
        system_gain_err_dn_per_e=gain_err / gain**2,
        dark_noise_e=transfer.read_noise_e,
        dark_noise_err_e=transfer.read_noise_e_err,
        dark_noise_dn=dark_dn,
        saturation_e=transfer.saturation_e,
        saturation_err_e=saturation_err_e,
        is_saturated=saturation.is_reached,
        threshold_e=gain * dark_dn + 0.5,
        dsnu_e=dsnu_dn.scaled(gain),
        prnu=prnu,
        dark_current_e_per_s=dark.current_e_per_s,
        dark_current_err_e_per_s=dark.current_e_per_s_err,
        linearity_error=None if linearity is None else linearity.mean_deviation,
    )
