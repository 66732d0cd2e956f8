"""The height series of a session, each compared with what the models make of its nearest image."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from acquisition.session import CaptureRecord, Session
from analysis.comparison import ModelMean, PairComparison, compare_pair, mean_metrics
from analysis.errors import AnalysisError
from analysis.results_file import finite_or_null, write_results
from simulation import MODELS, GaussianPsf, Model

__all__ = [
    "COMPARISON_SCHEMA",
    "SeriesComparison",
    "SeriesPair",
    "compare_series",
    "series_of",
    "write_comparison",
]

COMPARISON_SCHEMA = "standoff.comparison/1"
COMPARED_KINDS = ("texture", "chart")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeriesPair:
    """One pair of a height series: the records of both captures and how they compare."""

    reference: CaptureRecord
    followup: CaptureRecord
    comparison: PairComparison


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeriesComparison:
    """All pairs of a session, and the means over them: the paper's Table II.

    ``left_out`` says which pairs could not be compared, and why.
    """

    pairs: tuple[SeriesPair, ...]
    means: dict[Model, ModelMean]
    left_out: tuple[str, ...] = ()


def series_of(session: Session) -> list[list[CaptureRecord]]:
    """Captures of each textured target and orientation, from the nearest to the furthest."""
    series: dict[tuple[str, str, float], list[CaptureRecord]] = defaultdict(list)
    for record in session.records:
        if record.kind in COMPARED_KINDS:
            series[record.kind, record.target, record.orientation_deg].append(record)
    ordered = (sorted(records, key=lambda r: r.height_mm) for records in series.values())
    return [records for records in ordered if records[-1].height_mm > records[0].height_mm]


def compare_series(
    session: Session, psf: GaussianPsf, progress: Callable[[int], None] = lambda _: None
) -> SeriesComparison:
    """Simulate every height from the nearest one, and compare with what was captured there.

    Parameters
    ----------
    session
        With captures of kind texture or chart at two heights or more.
    psf
        Total PSF of the camera.
    progress
        Called with the number of pairs done.

    Raises
    ------
    AnalysisError
        If there is no such series, or not two captures of one can be aligned.
    SessionError
        If a capture file is missing or changed.
    """
    pairs: list[SeriesPair] = []
    left_out: list[str] = []
    for nearest, *others in series_of(session):
        reference = session.load(nearest).mean_dn
        for record in others:
            if record.height_mm <= nearest.height_mm:
                continue
            try:
                comparison = compare_pair(reference, session.load(record).mean_dn, psf)
            except AnalysisError as error:
                left_out.append(f"{nearest.file} and {record.file}: {error}")
                continue
            pairs.append(SeriesPair(reference=nearest, followup=record, comparison=comparison))
            progress(len(pairs))
    if left_out and not pairs:
        raise AnalysisError(left_out[0])
    if not pairs:
        raise AnalysisError(
            f"{session.path}: no target of kind texture or chart was captured at two heights"
        )
    means = {model: mean_metrics([p.comparison.metrics[model] for p in pairs]) for model in MODELS}
    return SeriesComparison(pairs=tuple(pairs), means=means, left_out=tuple(left_out))


def write_comparison(path: Path, comparison: SeriesComparison) -> None:
    """Write the comparison as JSON, whole or not at all.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.
    """
    document = {
        "schema": COMPARISON_SCHEMA,
        "table_2": {
            model: finite_or_null(asdict(mean)) for model, mean in comparison.means.items()
        },
        "pairs": [_pair_document(pair) for pair in comparison.pairs],
        "left_out": list(comparison.left_out),
    }
    write_results(path, document)


def _pair_document(pair: SeriesPair) -> dict[str, Any]:
    registration = pair.comparison.registration
    return {
        "target": pair.reference.target,
        "orientation_deg": pair.reference.orientation_deg,
        "reference": pair.reference.index,
        "followup": pair.followup.index,
        "reference_height_mm": pair.reference.height_mm,
        "followup_height_mm": pair.followup.height_mm,
        "zoom": registration.zoom,
        "zoom_err": registration.zoom_err,
        "models": {
            model: finite_or_null(asdict(m)) for model, m in pair.comparison.metrics.items()
        },
    }
