"""How well models predict captured follow-ups: Tables I and II of a whole session.

Table I compares curves: how a metric between the reference and the follow-up falls with the
distance, once for the captured and once for the simulated follow-ups. Table II compares the
follow-ups themselves. ``docs/validation.md`` holds the definitions.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.session import Session
from analysis.comparison import ModelMean, mean_metrics
from analysis.validation.alignment import PROCEDURES, Procedure
from analysis.validation.kernels import KernelBook
from analysis.validation.metrics import ImageMetrics
from analysis.validation.models import ValidationModel
from analysis.validation.pair import PairValidation, validate_pair
from analysis.validation.screening import RegisteredPair, Screening
from simulation import GaussianPsf

__all__ = ["METRICS", "CurveError", "Validation", "curve_errors", "table_1", "table_2", "validate"]

METRICS = ("correlation", "mse_dn2", "nmi", "psnr_db", "ssim")
"""The five metrics, as ``ImageMetrics`` names them."""

_SHOWN_ZOOM = 2.0
"""Figure 2 shows the follow-up that is nearest to it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveError:
    """Mean squared differences between curves over the zoom, one for each metric: Table I."""

    correlation: float
    mse_dn2: float
    nmi: float
    psnr_db: float
    ssim: float
    pairs: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Validation:
    """All pairs of a session with their metrics, and what did not count."""

    pairs: tuple[PairValidation, ...]
    screening: Screening
    models: tuple[ValidationModel, ...]

    @property
    def rows(self) -> tuple[tuple[Procedure, ValidationModel], ...]:
        """The rows of both tables."""
        return tuple((procedure, model) for procedure in PROCEDURES for model in self.models)


def validate(
    session: Session,
    psf: GaussianPsf,
    screening: Screening,
    models: Sequence[ValidationModel],
    book: KernelBook,
    progress: Callable[[int], None] = lambda _: None,
) -> Validation:
    """Compare all pairs that count.

    Parameters
    ----------
    session
        The session that was screened.
    psf
        Total PSF of the camera.
    screening
        What counts.
    models
        The models to try.
    book
        Kernels of the learned ones; what is missing is trained.
    progress
        Called with the number of pairs done.

    Raises
    ------
    AnalysisError
        If two images share too little, or a kernel cannot be trained.
    ResultsFileError
        If the cache of kernels cannot be read or written.
    SessionError
        If a capture file is missing or changed.
    """
    shown = _shown_pairs(screening.pairs)
    done = []
    for number, pair in enumerate(screening.pairs):
        near = session.load(pair.reference).mean_dn
        zoom = pair.registration.zoom
        kernels = {model: book.kernel(near, model, zoom) for model in models}
        done.append(
            validate_pair(
                (pair.reference, pair.followup),
                near,
                session.load(pair.followup).mean_dn,
                pair.registration,
                psf,
                kernels,
                keep_images=number in shown,
            )
        )
        progress(len(done))
    return Validation(pairs=tuple(done), screening=screening, models=tuple(models))


def table_1(validation: Validation) -> Mapping[tuple[Procedure, ValidationModel], CurveError]:
    """Table I: how far the simulated curves are from the captured ones."""
    return {
        row: curve_errors(
            (pair.captured_curves[row[0]], pair.models[row].curve) for pair in validation.pairs
        )
        for row in validation.rows
    }


def table_2(validation: Validation) -> Mapping[tuple[Procedure, ValidationModel], ModelMean]:
    """Table II: how alike simulated and captured follow-ups are."""
    return {
        row: mean_metrics([p.models[row].agreement for p in validation.pairs])
        for row in validation.rows
    }


def curve_errors(points: Iterable[tuple[ImageMetrics, ImageMetrics]]) -> CurveError:
    """Mean squared difference of two curves, given as pairs of points.

    A PSNR that is infinite on both curves does not differ.

    Raises
    ------
    ValueError
        If there is no point.
    """
    pairs = list(points)
    if not pairs:
        raise ValueError("no points of curves to compare")
    errors = {}
    for name in METRICS:
        first, second = np.array([[getattr(m, name) for m in pair] for pair in pairs]).T
        differs = first != second
        errors[name] = float(np.sum((first[differs] - second[differs]) ** 2)) / len(pairs)
    return CurveError(**errors, pairs=len(pairs))


def _shown_pairs(pairs: Sequence[RegisteredPair]) -> set[int]:
    """Number of one pair of every target: the first reference's, about twice as far away."""
    best: dict[tuple[str, float], int] = {}
    for number, pair in enumerate(pairs):
        key = (pair.reference.target, pair.reference.orientation_deg)
        if key not in best:
            best[key] = number
            continue
        kept = pairs[best[key]]
        if pair.reference.index != kept.reference.index:
            continue
        here, there = (abs(p.registration.zoom - _SHOWN_ZOOM) for p in (pair, kept))
        if here < there:
            best[key] = number
    return set(best.values())
