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

from calibration.noise._pattern import PatternParts
from calibration.noise._photon_transfer import QUANTISATION_DN2, PhotonTransfer


@dataclass(frozen=True, slots=True, kw_only=True)
class EmvaRow:
    """A line of the data sheet: what it is, the standard's symbol, the value and its unit.

    ``err`` is a standard error, None where it is not known.
    """

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
    reached saturation; else it is the largest level of the format.
    """

    system_gain_dn_per_e: float
    system_gain_err_dn_per_e: float
    dark_noise_e: float
    dark_noise_err_e: float
    dark_noise_dn: float
    saturation_e: float
    saturation_err_e: float
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
    def dynamic_range(self) -> float:
        """Saturation over the absolute sensitivity threshold."""
        return self.saturation_e / self.threshold_e

    @property
    def dynamic_range_db(self) -> float:
        """The same in decibels."""
        return 20 * log10(self.dynamic_range)

    @property
    def dynamic_range_err_db(self) -> float:
        """Standard error of the dynamic range in decibels."""
        relative = hypot(
            self.saturation_err_e / self.saturation_e, self.dark_noise_err_e / self.threshold_e
        )
        return 20 / log(10) * relative

    @property
    def dynamic_range_bits(self) -> float:
        """The same in bits."""
        return log2(self.dynamic_range)

    def rows(self) -> Iterator[EmvaRow]:
        """Yield the lines of the data sheet, in the standard's order."""
        yield EmvaRow(
            name="overall system gain", symbol="K", value=self.system_gain_dn_per_e, unit="DN/e",
            err=self.system_gain_err_dn_per_e, digits=4,
        )  # fmt: skip
        yield EmvaRow(
            name="temporal dark noise", symbol="σ_d", value=self.dark_noise_e, unit="e",
            err=self.dark_noise_err_e,
        )  # fmt: skip
        yield EmvaRow(
            name="temporal dark noise, with rounding", symbol="σ_y.dark", value=self.dark_noise_dn,
            unit="DN", digits=3,
        )  # fmt: skip
        yield EmvaRow(
            name="signal-to-noise ratio, maximum", symbol="SNR_max", value=self.snr_max_db,
            unit="dB",
        )  # fmt: skip
        yield EmvaRow(name="", symbol="", value=log2(self.snr_max), unit="bits")
        yield EmvaRow(
            name="absolute sensitivity threshold", symbol="μ_e.min", value=self.threshold_e,
            unit="e",
        )  # fmt: skip
        yield EmvaRow(
            name="saturation capacity", symbol="μ_e.sat", value=self.saturation_e, unit="e",
            err=self.saturation_err_e, digits=0,
        )  # fmt: skip
        yield EmvaRow(
            name="dynamic range", symbol="DR", value=self.dynamic_range_db, unit="dB",
            err=self.dynamic_range_err_db,
        )  # fmt: skip
        yield EmvaRow(name="", symbol="", value=self.dynamic_range_bits, unit="bits")
        yield from _pattern_rows("DSNU_1288", self.dsnu_e, "e", 1.0)
        yield from _pattern_rows("PRNU_1288", self.prnu, "%", 100.0)
        if self.linearity_error is not None:
            yield EmvaRow(
                name="linearity error", symbol="LE", value=100 * self.linearity_error, unit="%",
                digits=3,
            )  # fmt: skip
        if self.dark_current_e_per_s is not None:
            yield EmvaRow(
                name="dark current", symbol="μ_c.mean", value=self.dark_current_e_per_s,
                unit="e/s", err=self.dark_current_err_e_per_s,
            )  # fmt: skip


def _pattern_rows(symbol: str, parts: PatternParts, unit: str, factor: float) -> Iterator[EmvaRow]:
    names = {
        "DSNU_1288": "dark signal nonuniformity",
        "PRNU_1288": "photo response nonuniformity",
    }
    scaled = parts.scaled(factor)
    yield EmvaRow(
        name=names[symbol], symbol=symbol, value=scaled.total, unit=unit, err=scaled.err, digits=3
    )
    for name, end, value in (
        ("of rows", ".row", scaled.rows),
        ("of columns", ".col", scaled.columns),
        ("of pixels", ".pixel", scaled.pixels),
    ):
        yield EmvaRow(name=name, symbol=f"{symbol}{end}", value=value, unit=unit, digits=3)


def emva_sheet(transfer: PhotonTransfer, dsnu_dn: PatternParts, prnu: PatternParts) -> EmvaSheet:
    """Return the data sheet of a photon transfer curve and of the sensor's patterns."""
    gain, gain_err = transfer.gain_e_per_dn, transfer.gain_e_per_dn_err
    saturation, dark, linearity = transfer.saturation, transfer.dark, transfer.linearity
    rounded_e = hypot(transfer.read_noise_e, gain * sqrt(QUANTISATION_DN2))
    return EmvaSheet(
        system_gain_dn_per_e=1 / gain,
        system_gain_err_dn_per_e=gain_err / gain**2,
        dark_noise_e=transfer.read_noise_e,
        dark_noise_err_e=transfer.read_noise_e_err,
        dark_noise_dn=sqrt(max(transfer.offset_dn2, 0.0)),
        saturation_e=transfer.saturation_e,
        saturation_err_e=hypot(
            transfer.saturation_e * gain_err / gain, gain * (saturation.err_dn or 0.0)
        ),
        is_saturated=saturation.is_reached,
        threshold_e=rounded_e + 0.5,
        dsnu_e=dsnu_dn.scaled(gain),
        prnu=prnu,
        dark_current_e_per_s=dark.current_e_per_s,
        dark_current_err_e_per_s=dark.current_e_per_s_err,
        linearity_error=None if linearity is None else linearity.mean_deviation,
    )
