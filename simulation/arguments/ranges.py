"""Which numbers make sense, by the name of the argument; imports no library.

A name means the same wherever it stands, and the number is in the unit that the name ends in.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

_MOST = 1e12
"""Nothing in the units of a camera is as much."""


@dataclass(frozen=True, slots=True)
class Range:
    """From ``low`` to ``high``, or above ``low`` where it is open."""

    low: float = -_MOST
    high: float = _MOST
    is_open: bool = False

    def holds(self, number: float) -> bool:
        """Whether a number is in it."""
        above = number > self.low if self.is_open else number >= self.low
        return above and number <= self.high  # neither holds of what is no number

    def __str__(self) -> str:
        above = f"above {self.low:g}" if self.is_open else f"from {self.low:g}"
        if self.high < _MOST:
            return f"{above}{' and' if self.is_open else ''} up to {self.high:g}"
        if self.low == -_MOST:
            return f"of {_MOST:g} at most"
        return above if self.is_open else f"{above} on"

    def said_of(self, number: float) -> str:
        """What is asked of a number that it does not hold."""
        return f"of {_MOST:g} at most" if self.high == _MOST < number < inf else str(self)


def _named(names: str, range_: Range) -> dict[str, Range]:
    return dict.fromkeys(names.split(), range_)


RANGES: Mapping[str, Range] = {
    **_named(
        "zoom focal_length_px scale_px_per_mm pixel_size_mm min_d_prime timeout_s workers_gone_s "
        "false_alarms edge_length_px white_level contrast_dn scene_noise_dn rate gain_e_per_dn",
        Range(0, is_open=True),
    ),
    **_named(
        "sigma_px sigma_x_px sigma_y_px sigmas_px spot_sigma_px signal_sigma_px",
        Range(0, 1e4, is_open=True),
    ),
    **_named(
        "exposure exposure_us dark_exposures_us flat_exposures_us noise_dn noises_dn "
        "curve_noise_dn reference_noise light_scatter read_noise_e least index indices retake",
        Range(0),
    ),
    **_named("psf_variance_err_px2 psf_focus_share focus_freedom noise_relative_err", Range(0)),
    **_named("focus_scatter_px2 registration_err_px height_scatter_mm", Range(0, 1e4)),
    **_named("height_mm heights_mm reference_height_mm", Range(-1e6, 1e6)),
    **_named("tilts_deg at_tilt_deg reference_tilt_deg", Range(-90, 90)),
    **_named("direction_deg orientation_deg", Range(-360, 360)),
    **_named(
        "zooms reference_zoom at_zoom threads workers steps crop_px stride_px window_px crops "
        "pairs page references photograph_count edges_per_capture frames readings epochs batch "
        "frames_averaged part image_size size reference_size count",
        Range(1),
    ),
    **_named("test_fraction vignetting", Range(0, 1)),
    "false_discovery_rate": Range(0, 1, is_open=True),
    "seed": Range(0, 2**63),  # as wide as PyTorch's
    "rho": Range(-1, 1),
    # Telephones have 0.5 um, panels for X-rays 0.2 mm: a number below is one in mm.
    "pixel_pitch_um": Range(0.1, 1000),
    **_named(
        "samples_per_px cut_off_period_px diameter step_cy_per_px",
        Range(0, 1e4, is_open=True),
    ),
    **_named("obscured asymmetry", Range(0, 1)),
}
"""Any number that is not absurd for the other names."""


def range_of(name: str) -> Range:
    """Which numbers an argument of a name may be."""
    return RANGES.get(name, Range())
