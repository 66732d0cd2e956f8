"""Arguments that cannot be: their error, paths as callers give them, and ranges by name."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import inf
from os import PathLike, fspath
from pathlib import Path
from typing import TypeAlias


class ArgumentError(ValueError):
    """An argument of a public function is invalid, or contradicts another argument.

    ``argument`` is its name in Python, None if there is no single one; ``reason`` is the message
    without that name, for interfaces that use another name.

    Examples
    --------
    >>> try:
    ...     standoff.reading("sunlight")
    ... except standoff.ArgumentError as error:
    ...     print(error)
    encoding: expected auto, linear, srgb or gamma:G such as gamma:2.2, got 'sunlight'
    """

    def __init__(self, reason: str, *, argument: str | None = None) -> None:
        super().__init__(reason)
        self.argument = argument

    @property
    def reason(self) -> str:
        """The message without the name of the argument."""
        return str(self.args[0])

    def __str__(self) -> str:
        return self.reason if self.argument is None else f"{self.argument}: {self.reason}"


class ArgumentTypeError(ArgumentError, TypeError):
    """An argument of a public function has the wrong type."""


def kind_of(value: object) -> str:
    """Name the type of an argument, for a message."""
    return "None" if value is None else type(value).__name__


FilePath: TypeAlias = str | PathLike[str]


def path_of(path: object, name: str) -> Path:
    """The argument ``name`` as a path; refused if it is none, or nothing can have such a name."""
    if not isinstance(path, str | PathLike):
        raise ArgumentTypeError(f"expected a path, got {kind_of(path)}", argument=name)
    text = fspath(path)
    if not isinstance(text, str) or not text or "\0" in text:
        raise ArgumentError(f"{text!r} is not a valid name of a file or folder", argument=name)
    return path if isinstance(path, Path) else Path(text)


def output_path(path: object, name: str, suffixes: Collection[str]) -> Path:
    """The path of a file to write; refused also if its name ends in none of the suffixes."""
    out = path_of(path, name)
    if out.suffix.lower() not in suffixes:
        listed = " or ".join(sorted(suffixes))
        raise ArgumentError(
            f"{str(out)!r} must end in {listed}, which is what is written", argument=name
        )
    return out


_MOST = 1e12
"""Nothing in the units of a camera is as much."""


@dataclass(frozen=True, slots=True)
class _Range:
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


def _of_names(names: str, range_: _Range) -> dict[str, _Range]:
    return dict.fromkeys(names.split(), range_)


RANGES: Mapping[str, _Range] = {
    **_of_names(
        "zoom focal_length_px plane_depth scale_px_per_mm pixel_size_mm min_d_prime timeout_s "
        "workers_gone_s false_alarms edge_length_px white_level contrast_dn scene_noise_dn rate "
        "gain_e_per_dn",
        _Range(0, is_open=True),
    ),
    **_of_names(
        "sigma_px sigma_x_px sigma_y_px sigmas_px spot_sigma_px signal_sigma_px",
        _Range(0, 1e4, is_open=True),
    ),
    **_of_names(
        "exposure exposure_us dark_exposures_us flat_exposures_us noise_dn noises_dn "
        "curve_noise_dn reference_noise light_scatter read_noise_e least index indices retake",
        _Range(0),
    ),
    **_of_names("psf_variance_err_px2 psf_focus_share focus_freedom noise_relative_err", _Range(0)),
    **_of_names("focus_scatter_px2 registration_err_px height_scatter_mm", _Range(0, 1e4)),
    **_of_names("height_mm heights_mm reference_height_mm", _Range(-1e6, 1e6)),
    **_of_names("tilts_deg at_tilt_deg reference_tilt_deg", _Range(-90, 90)),
    **_of_names("direction_deg orientation_deg", _Range(-360, 360)),
    **_of_names(
        "zooms reference_zoom at_zoom threads workers steps crop_px stride_px window_px crops "
        "pairs page references photograph_count edges_per_capture frames readings epochs batch "
        "frames_averaged part image_size size reference_size count",
        _Range(1),
    ),
    **_of_names("test_fraction vignetting", _Range(0, 1)),
    "false_discovery_rate": _Range(0, 1, is_open=True),
    "depth_contrast": _Range(0, 0.99, is_open=True),
    "depth_freq_cy_per_px": _Range(0, 1, is_open=True),
    "focus_mm": _Range(-1e6, 1e6),
    "seed": _Range(0, 2**63),  # as wide as PyTorch's
    "rho": _Range(-1, 1),
    # Telephones have 0.5 um, panels for X-rays 0.2 mm: a number below is one in mm.
    "pixel_pitch_um": _Range(0.1, 1000),
    **_of_names(
        "samples_per_px cut_off_period_px diameter step_cy_per_px",
        _Range(0, 1e4, is_open=True),
    ),
    **_of_names("obscured asymmetry", _Range(0, 1)),
}
"""Any number that is not absurd for the other names."""


def range_of(name: str) -> _Range:
    """Which numbers an argument of a name may be."""
    return RANGES.get(name, _Range())
