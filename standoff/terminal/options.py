"""Options that several commands share, and how their values are checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from os.path import lexists, realpath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquisition.quantities import ImplausibleQuantityError, understood
from acquisition.spelling import decimal_comma_remedy
from acquisition.units import UnknownUnitError
from analysis.choices import VALIDATION_MODELS, ValidationModel
from simulation.choices import PsfShape
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig
    from hil_mocks import SimulatedBench


Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on stdout and nothing else.")
]
TransferForm = Annotated[
    PsfShape,
    typer.Option(
        "--transfer",
        help="PSF of psf.json to use: the best it has, the Gaussian, or the measured one.",
    ),
]
Threads = Annotated[
    int, typer.Option("--threads", min=1, help="Threads that share the rows of an image.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace results that are already there.")]
BenchFile = Annotated[Path, typer.Option("--bench", help="Bench file (TOML).")]
BenchKeys = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a bench key; may be repeated."),
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

    if not settings:
        return load_bench(path)
    load_bench(path)
    try:
        return load_bench(path, parse_overrides(settings))
    except BenchConfigError as error:
        raise typer.BadParameter(str(error)) from error


def place_target(
    simulated: SimulatedBench | None, target: str, orientation_deg: float = 0.0
) -> None:
    """Place a target under the simulated camera; refuse a real one."""
    if simulated is None:
        raise typer.BadParameter("only a simulated bench takes a target", param_hint="--target")
    try:
        simulated.place(target, orientation_deg)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--target") from error


def checked_zoom(zoom: float | None) -> float | None:
    """Accept a zoom-out that is finite and at least 1, or None."""
    if zoom is not None and not (math.isfinite(zoom) and zoom >= 1):
        ratio = f"; the ratio of distances is {1 / zoom:g}" if 0.01 <= zoom < 1 else ""
        raise typer.BadParameter(f"a zoom-out must be a number of at least 1, got {zoom:g}{ratio}")
    return zoom


def checked_pitch(pitch_um: float | None) -> float | None:
    """Accept a pixel pitch that is finite and positive, or None."""
    if pitch_um is not None and not (math.isfinite(pitch_um) and pitch_um > 0):
        raise typer.BadParameter(f"a pixel pitch must be positive, got {pitch_um:g}")
    return pitch_um


def quantity(name: str) -> Callable[[str], float]:
    """Return a parser of a number with or without its unit; refuse an implausible one.

    ``name`` is the option's in the table of plausible ranges, and ends in the unit.
    """

    def parsed(text: str | float) -> float:
        try:
            return float(str(understood(name, str(text))))
        except (ImplausibleQuantityError, UnknownUnitError) as error:
            raise typer.BadParameter(f"{name} {error}") from error
        except ValueError as error:
            remedy = decimal_comma_remedy(str(text), name) or "expected a number"
            raise typer.BadParameter(f"{text}: {remedy}") from error

    return parsed


def chosen_models(text: str) -> tuple[ValidationModel, ...]:
    """Return the models named in a comma-separated list, in the order of the tables."""
    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in VALIDATION_MODELS]
    if unknown:
        raise typer.BadParameter(
            f"unknown model {unknown[0]!r}; the models are {', '.join(VALIDATION_MODELS)}",
            param_hint="--models",
        )
    return tuple(model for model in VALIDATION_MODELS if model in names)


def region_corner_and_size(text: str, expected: str) -> tuple[int, int, int, int]:
    """Read ``X,Y,W,H`` in px; ``expected`` names the accepted forms in the error."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(
            f"expected {expected}, got {text}", param_hint="--region"
        ) from error
    return x, y, width, height


def refuse_overwriting(
    outputs: Sequence[Path | None], inputs: Sequence[Path | None] = (), *, force: bool
) -> None:
    """Refuse, before any work, a result that would overwrite something.

    Parameters
    ----------
    outputs
        Every file that the command will write; None for what is not asked for.
    inputs
        The files that it reads.
    force
        Whether results that are already there may be replaced. Inputs never may.

    Raises
    ------
    typer.BadParameter
        If a result is an input or another result.
    ApplicationError
        If there is a file at its place already; the message names it.
    """
    # Path.resolve raises where symbolic links form a loop; the reader names that better.
    taken = {realpath(path) for path in inputs if path is not None}
    results = [path for path in outputs if path is not None]
    for path in results:
        if realpath(path) in taken:
            raise typer.BadParameter(f"{path} is already an input or output; name another file")
        taken.add(realpath(path))
    for path in results:
        if path.is_dir():
            raise ApplicationError(f"cannot write {path}: it is a folder")
        if path.exists() and not path.is_file():
            raise ApplicationError(f"cannot write {path}: it is not a regular file")
        if lexists(path) and not force:
            raise ApplicationError(
                f"{path} exists already; --force replaces it, or name another file"
            )


def refuse_suffix(path: Path | None, option: str, suffixes: set[str]) -> None:
    """Refuse a file name whose suffix does not match the format that is written."""
    if path is not None and path.suffix.lower() not in suffixes:
        names = " or ".join(sorted(suffixes))
        raise typer.BadParameter(f"{path} must end in {names}", param_hint=option)
