"""The signal of a camera without light: the black level, and its growth with the exposure."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

_SIGNIFICANT = 3.0
_US_PER_S = 1e6
_CLEAR_OF_ZERO = 3.0


class DarkSample(Protocol):
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
class DarkSignal:
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

    def in_electrons(self, gain_e_per_dn: float) -> "DarkSignal":
        """The same signal with the dark current in electrons."""
        if self.rate_err_dn_per_us is None:
            return self
        unit = gain_e_per_dn * _US_PER_S
        return replace(
            self,
            current_e_per_s=self.measured_rate_dn_per_us * unit,
            current_e_per_s_err=self.rate_err_dn_per_us * unit,
        )


def dark_signal(darks: Sequence[DarkSample]) -> DarkSignal:
    """Measure the black level, and the dark current if exposures differ.

    The standard error is the larger of those from the temporal noise and from the scatter of the
    captures: a black level that drifts from capture to capture is known no better.

    Parameters
    ----------
    darks
        At least one.
    """
    level = np.array([sample.mean_dn for sample in darks])
    temporal = np.array(
        [np.sqrt(sample.variance_dn2 / (sample.frames * sample.pixels)) for sample in darks]
    )
    notes = _clipping_notes(darks)
    err = float(np.sqrt(np.sum(temporal**2)) / level.size)
    if level.size > 1:
        err = max(err, float(level.std(ddof=1) / np.sqrt(level.size)))
    steady = DarkSignal(black_level_dn=float(level.mean()), black_level_dn_err=err, notes=notes)
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
    return DarkSignal(
        black_level_dn=float(values[0]),
        black_level_dn_err=float(np.sqrt(covariance[0, 0])),
        rate_dn_per_us=rate,
        rate_err_dn_per_us=rate_err,
        measured_rate_dn_per_us=rate,
        notes=notes,
    )


def _clipping_notes(darks: Sequence[DarkSample]) -> tuple[str, ...]:
    low = [
        sample for sample in darks if sample.mean_dn < _CLEAR_OF_ZERO * np.sqrt(sample.variance_dn2)
    ]
    if not low:
        return ()
    return (
        "the dark level is so low that its noise is clipped at 0, and the read noise comes out too "
        "small; raise the camera's BlackLevel",
    )
