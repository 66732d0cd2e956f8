"""Options that several commands share, the values made of them, and how their texts are read."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from typer import Argument, BadParameter, Option

from acquisition.quantities import (
    ImplausibleQuantityError,
    UnknownUnitError,
    decimal_comma_remedy,
    decimals_meant,
    understood,
)
from analysis.choices import VALIDATION_MODELS, Observer, ValidationModel
from calibration.choices import DEFAULT_BOARD_TEXT
from simulation.choices import Model, PsfShape
from standoff import library
from standoff.errors import ArgumentError
from standoff.terminal._declaration import MadeBy, excludes
from standoff.terminal._output import note

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig
    from acquisition.photographs import ReadOptions
    from analysis.sweep import SweepOptions
    from calibration.geometry import CharucoBoard
    from standoff import AlignmentHints

Region = TypeVar("Region")

TransferForm = Annotated[
    PsfShape,
    Option(
        "--transfer",
        help="Form of the PSF to use: the best in psf.json, the Gaussian, or the measured one.",
    ),
]
Threads = Annotated[
    int, Option("--threads", min=1, help="Number of threads that work on an image.")
]
SessionFolder = Annotated[Path, Argument(help="Session folder.", show_default=False)]
OperatorName = Annotated[
    str | None, Option("--operator", help="Name of the operator; the login name by default.")
]
KernelWorkers = Annotated[
    int, Option("--workers", min=1, max=1024, help="Number of processes that train kernels.")
]
BenchFile = Annotated[Path, Option("--bench", help="Bench file (TOML).")]
BenchKeys = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="Override a bench key; may be repeated."),
]


def read_bench(path: Path, settings: list[str] | None) -> BenchConfig:
    """Read a bench file with its ``--set`` overrides; a bad override is wrong usage."""
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


PixelPitch = Annotated[
    float | None,
    Option(
        parser=quantity("pixel_pitch_um"),
        callback=checked_pitch,
        metavar="UM",
        help="Pixel pitch of the sensor, for lp/mm; by default that of the session's bench file or "
        "of the EXIF data.",
    ),
]

_Name = Annotated[str | None, Option(metavar="TEXT")]


def _labels(
    lens: _Name = None,
    camera: _Name = None,
    chart: _Name = None,
    customer: _Name = None,
    operator: _Name = None,
) -> dict[str, str]:
    """Return the names that are given, as psf.json calls them.

    Options
    -------
    lens: Name of the lens on the first page of the report.
    camera: Name of the camera on the first page of the report.
    chart: Name of the edge target, for the first page of the report.
    customer: Name of the customer on the first page of the report.
    operator: Name of the operator on the first page of the report.
    """
    named = {"lens": lens, "camera": camera, "target": chart, "customer": customer}
    return {
        name: text for name, text in (named | {"operator": operator}).items() if text is not None
    }


Labels = Annotated["dict[str, str]", MadeBy(_labels)]


BOARD_FORM = "COLSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]"


def charuco_board(
    board: Annotated[str, Option(metavar=BOARD_FORM)] = DEFAULT_BOARD_TEXT,
) -> CharucoBoard:
    """Return the board that ``--board`` describes.

    Options
    -------
    board: The ChArUco board.
    """
    from calibration.geometry import CharucoBoard

    try:
        return CharucoBoard.from_text(board)
    except ValueError as error:
        raise BadParameter(str(error), param_hint="--board") from error


Board = Annotated["CharucoBoard", MadeBy(charuco_board)]


def chosen_models(text: str | None) -> tuple[ValidationModel, ...] | None:
    """Return the models that a comma-separated list names, in the order of the tables."""
    if text is None:
        return None
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


def parsed_size(text: str | None, option: str = "--image-size") -> tuple[int, int] | None:
    """Return the width and height in px that ``WxH`` names; None of none."""
    if text is None:
        return None
    size = re.fullmatch(r"(\d{1,6})\s*[x,×]\s*(\d{1,6})", text.strip().lower(), re.ASCII)
    if size is None:
        raise BadParameter(f"{option} must be WxH in px, such as 780x580, got {text}")
    return int(size[1]), int(size[2])


EncodingName = Annotated[
    str,
    Option(
        "--encoding",
        metavar="ENCODING",
        help="Encoding of the stored levels: auto (as the file states, or as is usual for its "
        "format), linear, srgb or gamma:G.",
    ),
]
_Page = Annotated[
    int | None, Option("--page", min=1, help="Which image of a stack to read, from 1.")
]
_Mean = Annotated[
    bool, Option("--mean", help="Read a stack as one capture: its mean and variance.")
]


def reading_options(
    encoding: EncodingName = "auto", page: _Page = None, mean: _Mean = False
) -> ReadOptions:
    """Return how photographs are read by the values of these options."""
    if mean and page is not None:
        raise BadParameter("give --page or --mean, not both", param_hint="--mean")
    try:
        return library.reading(encoding, page=page, mean=mean)
    except ArgumentError as error:
        raise BadParameter(str(error), param_hint="--encoding") from error


def _reading_with_short_forms(
    encoding: EncodingName = "auto",
    srgb: Annotated[bool | None, Option("--srgb/--linear")] = None,
    page: _Page = None,
    mean: _Mean = False,
) -> ReadOptions:
    """How photographs are read, with short forms of the encoding.

    Options
    -------
    srgb: Short for --encoding srgb and --encoding linear.
    """
    if srgb is None:
        return reading_options(encoding, page, mean)
    if encoding != "auto":
        raise BadParameter("give --encoding or its short form, not both", param_hint="--encoding")
    return reading_options("srgb" if srgb else "linear", page, mean)


Reading = Annotated["ReadOptions", MadeBy(reading_options)]
ReadingWithShortForms = Annotated["ReadOptions", MadeBy(_reading_with_short_forms)]

Workers = Annotated[int, Option("--workers", min=1, help="Number of processes on this machine.")]
AsParquet = Annotated[
    bool,
    Option("--parquet", help="Also write the table as Parquet; needs the extra parquet."),
]


def _sweep_options(
    workers: Workers = 1,
    scheduler: Annotated[str | None, Option()] = None,
    shard: Annotated[str, Option(metavar="K/N")] = "1/1",
    strict: Annotated[bool, Option("--strict")] = False,
) -> SweepOptions:
    """Return who works on what part; refuse a part that there is not.

    Options
    -------
    scheduler: Dask scheduler, tcp://HOST:PORT, instead of --workers.
    shard: Do only part K of N, for batch jobs that share the folder of results.
    strict: Stop at the first photograph that cannot be used.
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
    return SweepOptions(workers=workers, scheduler=scheduler, part=part, strict=strict)


Sweep = Annotated["SweepOptions", MadeBy(_sweep_options)]


def _alignment_hints(
    expect_zoom: Annotated[float | None, Option(min=0.05, max=20, metavar="Z")] = None,
    homography: Annotated[Path | None, Option(metavar="H.json")] = None,
    points: Annotated[Path | None, Option(metavar="P.csv")] = None,
    mask: Annotated[Path | None, Option(metavar="M.png")] = None,
    mirrored: Annotated[bool, Option("--mirrored")] = False,
) -> AlignmentHints | None:
    """What is known of the pose.

    Options
    -------
    expect_zoom: Approximate ratio of the distances, follow-up over reference; below 1 if the
        follow-up is nearer.
    homography: Approximate pose, follow-up to reference pixels; it is refined.
    points: At least four pairs of points, good to a few pixels, with the header
        followup_x_px,followup_y_px,reference_x_px,reference_y_px.
    mask: Image of the same size as the follow-up; pixels where it is not 0 are left out.
    mirrored: One photograph is mirrored; without this option, such a pair is refused.
    """
    return library.alignment_hints(
        expect_zoom, homography=homography, points=points, mask=mask, mirrored=mirrored
    )


Hints = Annotated["AlignmentHints | None", MadeBy(_alignment_hints)]
HINTS = ("expect_zoom", "homography", "points", "mask", "mirrored")
_ENOUGH = "each gives the approximate pose"
HINT_RULES = (
    excludes("expect_zoom", "homography", "points", because=_ENOUGH),
    excludes("homography", "points", because=_ENOUGH),
)
"""Rules for a command with ``Hints``."""


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
        help="Standard deviation of the PSF's variance from capture to capture in px^2, due to "
        "focus; by default as measured in the captures of the calibration.",
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
DepthFolder = Annotated[
    Path | None,
    Option(
        help="Folder of depth maps (TIFF, PNG) or lists of planes (JSON), named like the "
        "photographs; by default, scenes are flat."
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


def _curve_choice(
    model: CurveModel = None,
    observer: Annotated[Observer | None, Option()] = None,
    noise: Annotated[float | None, Option()] = None,
    contrast: Annotated[float | None, Option()] = None,
) -> library.CurveChoice:
    """Which curve of a file to use.

    Options
    -------
    observer: Use the curve for this observer.
    noise: Use the curve for this noise in DN.
    contrast: Use the curve for this contrast in DN.
    """
    return library.CurveChoice(model=model, observer=observer, noise_dn=noise, contrast_dn=contrast)


Choice = Annotated["library.CurveChoice", MadeBy(_curve_choice)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedNumbers:
    """What the numbers of an option may be: from ``least`` (-inf for any), or above 0.

    Of two whole numbers, the second is probably a decimal if it is ``pair_most`` or more. Numbers
    that are written twice count once, unless they ``may_repeat``.
    """

    option: str
    least: float | None = None
    pair_most: float | None = None
    may_repeat: bool = False

    @property
    def bound(self) -> str:
        """The bound in words."""
        if self.least == -math.inf:
            return "that are finite"
        return "above 0" if self.least is None else f"of at least {self.least:g}"

    def accepts(self, value: float) -> bool:
        """Whether a value is finite and within the bound."""
        is_within = value > 0 if self.least is None else value >= self.least
        return math.isfinite(value) and is_within


def number_list(text: str, listed: ListedNumbers) -> list[float]:
    """Read numbers separated by commas, in the order in which they are written."""
    meant = decimals_meant(text, listed.accepts, listed.pair_most)
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        remedy = "" if meant is None else f"; write {meant}, with commas between the numbers only"
        raise BadParameter(
            f"expected numbers, got {text}{remedy}", param_hint=listed.option
        ) from error
    refused = next((value for value in values if not listed.accepts(value)), None)
    if meant is not None:
        confirmed = ",".join(f"{value:.1f}" for value in values)
        otherwise = f", or {confirmed} if they are right" if refused is None else ""
        raise BadParameter(
            f"{text} is {len(values)} numbers; decimals were probably meant: "
            f"write {meant}{otherwise}",
            param_hint=listed.option,
        )
    if refused is not None:
        raise BadParameter(
            f"expected numbers {listed.bound}, got {refused:g}", param_hint=listed.option
        )
    if listed.pair_most is not None and re.fullmatch(r"\d,\d", text):
        whole, fraction = text.split(",")
        note(
            f"{listed.option} {text} is two numbers, {whole} and {fraction}; "
            f"a single one is written {whole}.{fraction}"
        )
    return values if listed.may_repeat else list(dict.fromkeys(values))
