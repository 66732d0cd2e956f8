"""Options that several commands share, and what their values mean."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from typer import Argument, BadParameter, Option

from acquisition.quantities import (
    ImplausibleQuantityError,
    UnknownUnitError,
    decimal_comma_remedy,
    understood,
)
from analysis.choices import VALIDATION_MODELS, Observer, ValidationModel
from simulation.choices import Model, PsfShape
from standoff import library
from standoff.errors import ArgumentError
from standoff.terminal.option_rules import excludes

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig
    from acquisition.photographs import ReadOptions
    from analysis.sweep import SweepOptions
    from calibration.geometry import CharucoBoard

Region = TypeVar("Region")

Json = Annotated[bool, Option("--json", help="Print one JSON document on stdout and nothing else.")]
TransferForm = Annotated[
    PsfShape,
    Option(
        "--transfer",
        help="PSF of psf.json to use: the best it has, the Gaussian, or the measured one.",
    ),
]
Threads = Annotated[
    int, Option("--threads", min=1, help="Threads that share the rows of an image.")
]
Force = Annotated[bool, Option("--force", help="Replace results that are already there.")]
SessionFolder = Annotated[Path, Argument(help="Session folder.", show_default=False)]
OperatorName = Annotated[
    str | None, Option("--operator", help="Name of the operator; the login name by default.")
]
KernelWorkers = Annotated[
    int, Option("--workers", min=1, max=1024, help="Worker processes that train kernels.")
]
BenchFile = Annotated[Path, Option("--bench", help="Bench file (TOML).")]
BenchKeys = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="Override a bench key; may be repeated."),
]


def read_bench(path: Path, settings: list[str] | None) -> BenchConfig:
    """Read a bench file with its ``--set`` overrides; a bad override is wrong usage.

    Raises
    ------
    BenchConfigError
        If the file itself cannot be read or has an invalid key or value.
    """
    from acquisition.bench import load_bench, parse_overrides
    from acquisition.errors import BenchConfigError

    as_written = load_bench(path)
    try:
        return load_bench(path, parse_overrides(settings)) if settings else as_written
    except BenchConfigError as error:
        raise BadParameter(str(error)) from error


def checked_zoom(zoom: float | None) -> float | None:
    """Accept a zoom-out that is finite and at least 1, or None."""
    if zoom is not None and not (math.isfinite(zoom) and zoom >= 1):
        ratio = f"; the ratio of distances is {1 / zoom:g}" if 0.01 <= zoom < 1 else ""
        raise BadParameter(f"a zoom-out must be a number of at least 1, got {zoom:g}{ratio}")
    return zoom


def checked_pitch(pitch_um: float | None) -> float | None:
    """Accept a pixel pitch that is finite and positive, or None."""
    if pitch_um is not None and not (math.isfinite(pitch_um) and pitch_um > 0):
        raise BadParameter(f"a pixel pitch must be positive, got {pitch_um:g}")
    return pitch_um


def quantity(name: str) -> Callable[[str], float]:
    """Return a parser of a number with or without its unit; refuse an implausible one.

    ``name`` is the option's in the table of plausible ranges, and ends in the unit.
    """

    def parsed(text: str | float) -> float:
        try:
            return float(str(understood(name, str(text))))
        except (ImplausibleQuantityError, UnknownUnitError) as error:
            raise BadParameter(f"{name} {error}") from error
        except ValueError as error:
            remedy = decimal_comma_remedy(str(text), name) or "expected a number"
            raise BadParameter(f"{text}: {remedy}") from error

    return parsed


def charuco_board(text: str) -> CharucoBoard:
    """Return the board that ``--board`` describes."""
    from calibration.geometry import CharucoBoard

    try:
        return CharucoBoard.from_text(text)
    except ValueError as error:
        raise BadParameter(str(error), param_hint="--board") from error


def chosen_models(text: str) -> tuple[ValidationModel, ...]:
    """Return the models named in a comma-separated list, in the order of the tables."""
    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in VALIDATION_MODELS]
    if unknown:
        raise BadParameter(
            f"unknown model {unknown[0]!r}; the models are {', '.join(VALIDATION_MODELS)}",
            param_hint="--models",
        )
    return tuple(model for model in VALIDATION_MODELS if model in names)


def parsed_region(text: str, expected: str, make: Callable[..., Region]) -> Region:
    """Make a region of ``X,Y,W,H`` in px; ``expected`` names the accepted forms in the error."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
        return make(x_px=x, y_px=y, width_px=width, height_px=height)
    except ValueError as error:
        raise BadParameter(f"expected {expected}, got {text}", param_hint="--region") from error


def parsed_size(text: str, option: str = "--image-size") -> tuple[int, int]:
    """Return the width and height in px that ``WxH`` names."""
    size = re.fullmatch(r"(\d{1,6})\s*[x,×]\s*(\d{1,6})", text.strip().lower(), re.ASCII)
    if size is None:
        raise BadParameter(f"{option} must be WxH in px, such as 780x580, got {text}")
    return int(size[1]), int(size[2])


EncodingName = Annotated[
    str,
    Option(
        "--encoding",
        metavar="ENCODING",
        help="How stored levels follow from light: auto (as the file states, or as is usual for "
        "its format), linear, srgb or gamma:G.",
    ),
]
ShortEncoding = Annotated[
    bool | None, Option("--srgb/--linear", help="Short for --encoding srgb and --encoding linear.")
]
Page = Annotated[
    int | None, Option("--page", min=1, help="Which image of a stack to read, from 1.")
]
Mean = Annotated[bool, Option("--mean", help="Read a stack as one capture: its mean and variance.")]


def reading_options(
    encoding: str, page: int | None, mean: bool, short: bool | None = None
) -> ReadOptions:
    """Return how photographs are read by the values of these options.

    Raises
    ------
    BadParameter, ArgumentError
        If the encoding is unknown, or two options contradict each other.
    """
    if short is not None and encoding != "auto":
        raise BadParameter("give --encoding or its short form, not both", param_hint="--encoding")
    if mean and page is not None:
        raise BadParameter("give --page or --mean, not both", param_hint="--mean")
    if short is not None:
        encoding = "srgb" if short else "linear"
    try:
        return library.reading(encoding, page=page, mean=mean)
    except ArgumentError as error:
        raise BadParameter(str(error), param_hint="--encoding") from error


Workers = Annotated[int, Option("--workers", min=1, help="Worker processes on this machine.")]
Scheduler = Annotated[
    str | None, Option("--scheduler", help="Dask scheduler, tcp://HOST:PORT, instead of --workers.")
]
PartOfShards = Annotated[
    str,
    Option(
        "--shard",
        metavar="K/N",
        help="Do the K-th of N parts only: for jobs of a queue that share the folder of results.",
    ),
]
Strict = Annotated[
    bool, Option("--strict", help="Stop at the first photograph that gives nothing.")
]


AsParquet = Annotated[
    bool,
    Option("--parquet", help="Also write the table as Parquet; needs the extra parquet."),
]


def sweep_options(
    workers: int, scheduler: str | None, shard: str, *, is_strict: bool
) -> SweepOptions:
    """Return what these options ask for.

    Raises
    ------
    BadParameter
        If there is no such part, or both a scheduler and workers are given.
    """
    from analysis.sweep import SweepOptions

    if scheduler is not None and workers != 1:
        raise BadParameter("give --scheduler or --workers, not both", param_hint="--scheduler")
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", shard)
    part = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= part[0] <= part[1]:
        raise BadParameter(
            f"expected K/N with K from 1 to N, such as 3/16, got {shard!r}", param_hint="--shard"
        )
    return SweepOptions(workers=workers, scheduler=scheduler, part=part, strict=is_strict)


ExpectZoom = Annotated[
    float | None,
    Option(
        min=0.05,
        max=20,
        metavar="Z",
        help="Approximate ratio of the distances, follow-up over reference; below 1 if the "
        "follow-up is nearer.",
    ),
]
PoseHint = Annotated[
    Path | None,
    Option(
        "--homography",
        metavar="H.json",
        help="Approximate pose, follow-up to reference pixels; it is refined.",
    ),
]
Points = Annotated[
    Path | None,
    Option(
        metavar="P.csv",
        help="At least four pairs of points, good to a few pixels, with the header "
        "followup_x_px,followup_y_px,reference_x_px,reference_y_px.",
    ),
]
Mask = Annotated[
    Path | None,
    Option(
        metavar="M.png", help="Image of the follow-up's size; pixels that are not 0 are left out."
    ),
]

Mirrored = Annotated[
    bool,
    Option(
        "--mirrored",
        help="One photograph shows the scene as in a mirror; without it, such a pair is refused.",
    ),
]

_ENOUGH = "each says what the pose is about"
HINT_RULES = (
    excludes("expect_zoom", "homography", "points", because=_ENOUGH),
    excludes("homography", "points", because=_ENOUGH),
)
"""Rules for a command with the parameters ``expect_zoom``, ``homography`` and ``points``."""


def _checked_threshold(min_dprime: float) -> float:
    if not 0 < min_dprime < float("inf"):
        raise BadParameter(f"a threshold must be a number above 0, got {min_dprime:g}")
    return min_dprime


CurvesPath = Annotated[
    Path, Option(help="curves.json from standoff detectability, or evaluation.json.")
]
MinDprime = Annotated[
    float,
    Option(
        "--min-dprime",
        help="Lowest d' that is good enough; 2 is an AUC of 0.92.",
        callback=_checked_threshold,
    ),
]
FocusScatter = Annotated[
    float | None,
    Option(
        "--focus-scatter",
        min=0,
        help="Standard deviation of the PSF's variance from capture to capture in px^2, as focus "
        "makes it; by default as the calibration's captures show it.",
    ),
]
FocalLengthOfTilts = Annotated[
    float | None,
    Option(
        "--focal-length-px",
        help="Focal length in px, for --tilts.",
        parser=quantity("focal_length_px"),
    ),
]
FocusScatterOfPairs = Annotated[
    float,
    Option(
        "--focus-scatter",
        min=0,
        help="Scatter of the PSF's variance between photographs in px^2.",
    ),
]
LightScatter = Annotated[
    float, Option(min=0, max=0.5, help="Relative scatter of the follow-up's exposure.")
]
ReferenceZoom = Annotated[
    float, Option(help="Zoom from photograph to reference.", callback=checked_zoom)
]
CurveModel = Annotated[Model | None, Option(help="Use the curve for this capture model.")]
CurveObserver = Annotated[Observer | None, Option(help="Use the curve for this observer.")]
CurveNoise = Annotated[float | None, Option(help="Use the curve for this noise in DN.")]
CurveContrast = Annotated[float | None, Option(help="Use the curve for this contrast in DN.")]


def curve_choice(
    model: Model | None,
    observer: Observer | None,
    noise_dn: float | None,
    contrast_dn: float | None,
) -> library.CurveChoice:
    """Return which curve these options mean."""
    return library.CurveChoice(
        model=model, observer=observer, noise_dn=noise_dn, contrast_dn=contrast_dn
    )
