"""Options that choose one curve of a curves.json."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.choices import Observer
from simulation.choices import Model

if TYPE_CHECKING:
    from analysis.detectability import DetectabilityCurve


CurvesPath = Annotated[Path, typer.Option(help="curves.json from standoff detectability.")]
MinDprime = Annotated[
    float, typer.Option("--min-dprime", help="Lowest d' that is good enough; 2 is an AUC of 0.92.")
]
CurveModel = Annotated[Model | None, typer.Option(help="Use the curve for this capture model.")]
CurveObserver = Annotated[Observer | None, typer.Option(help="Use the curve for this observer.")]
CurveNoise = Annotated[float | None, typer.Option(help="Use the curve for this noise in DN.")]
CurveContrast = Annotated[float | None, typer.Option(help="Use the curve for this contrast in DN.")]


def chosen_curve(
    path: Path,
    min_dprime: float,
    model: Model | None,
    observer: Observer | None,
    noise_dn: float | None,
    contrast_dn: float | None,
) -> DetectabilityCurve:
    """Read the chosen curve; an ambiguous choice or a bad threshold is wrong usage.

    Raises
    ------
    ResultsFileError
        If the file cannot be read.
    """
    from analysis.detectability import AmbiguousCurveError, CurveChoice, read_curves

    if not 0 < min_dprime < float("inf"):
        raise typer.BadParameter(
            f"a threshold must be a number above 0, got {min_dprime:g}", param_hint="--min-dprime"
        )
    choice = CurveChoice(model=model, observer=observer, noise_dn=noise_dn, contrast_dn=contrast_dn)
    try:
        return read_curves(path).chosen(choice)
    except AmbiguousCurveError as error:
        raise typer.BadParameter(f"{path}: {error}") from error
