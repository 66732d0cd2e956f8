"""Options that choose one curve of a curves.json."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.choices import Observer
from simulation.choices import Model

if TYPE_CHECKING:
    from standoff.library import CurveChoice


def _checked_threshold(min_dprime: float) -> float:
    if not 0 < min_dprime < float("inf"):
        raise typer.BadParameter(f"a threshold must be a number above 0, got {min_dprime:g}")
    return min_dprime


CurvesPath = Annotated[Path, typer.Option(help="curves.json from standoff detectability.")]
MinDprime = Annotated[
    float,
    typer.Option(
        "--min-dprime",
        help="Lowest d' that is good enough; 2 is an AUC of 0.92.",
        callback=_checked_threshold,
    ),
]
CurveModel = Annotated[Model | None, typer.Option(help="Use the curve for this capture model.")]
CurveObserver = Annotated[Observer | None, typer.Option(help="Use the curve for this observer.")]
CurveNoise = Annotated[float | None, typer.Option(help="Use the curve for this noise in DN.")]
CurveContrast = Annotated[float | None, typer.Option(help="Use the curve for this contrast in DN.")]


def curve_choice(
    model: Model | None,
    observer: Observer | None,
    noise_dn: float | None,
    contrast_dn: float | None,
) -> CurveChoice:
    """Return which curve these options mean."""
    from standoff.library import CurveChoice

    return CurveChoice(model=model, observer=observer, noise_dn=noise_dn, contrast_dn=contrast_dn)
