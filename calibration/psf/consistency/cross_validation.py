"""Which of the things that may be wrong with a calibration its edges show."""

from collections.abc import Sequence

import numpy as np

from calibration.edges import EdgeMeasurement
from calibration.psf.consistency.document import CrossValidation, Misfit
from calibration.psf.consistency.halves import check_edges, check_heights
from calibration.psf.consistency.misfits import (
    Evidence,
    edges_apart,
    focus_drift,
    focus_scatter,
    height_column,
    scatter_beside,
    shape,
    shared_of,
    soft_target,
    stage,
)
from calibration.psf.consistency.softness import SoftnessFit
from calibration.psf.repeatability import CaptureFit, capture_numbers, capture_of, without_blur

NAMED_P = 0.03
"""Significance, over all tests together, below which something is named."""


def cross_validate(
    seen: Sequence[EdgeMeasurement],
    adjusted: Sequence[EdgeMeasurement],
    softness: SoftnessFit | None,
    focus: CaptureFit | None,
    scatter_px: float,
) -> CrossValidation:
    """Test the model of the camera on its own edges, and name what does not fit.

    Parameters
    ----------
    seen, adjusted
        The edges as measured, and without the softness of the target.
    softness
        That of the target.
    focus
        What the captures share; None with one.
    scatter_px
        Scatter of widths within captures beyond their errors.
    """
    width_px = float(np.sqrt(np.mean([edge.sigma_px**2 for edge in adjusted])))
    edges, heights = check_edges(_levelled(adjusted, focus)), check_heights(adjusted)
    found: list[Evidence | None] = [soft_target(softness), stage(seen), shape(seen)]
    shared = shared_of(adjusted, softness)
    drift = focus_drift(adjusted, shared)
    # What drifts differs between captures as well: scatter is what is left beside the drift.
    is_drift = drift is not None and drift.matters and drift.p_value < NAMED_P / len(found)
    column = height_column(adjusted) if is_drift else None
    found += [drift, focus_scatter(scatter_beside(adjusted, column, shared), width_px)]
    if edges is not None:
        found.append(edges_apart(edges.p_value, scatter_px, width_px))
    made = [one for one in found if one is not None]
    return CrossValidation(
        edges=edges,
        heights=heights,
        p_values={one.kind: one.p_value for one in made},
        named=tuple(_named(made)),
    )


def _levelled(edges: Sequence[EdgeMeasurement], focus: CaptureFit | None) -> list[EdgeMeasurement]:
    """The edges at one focus: what is left is within captures."""
    offsets = {} if focus is None else focus.offset_px2
    numbers = capture_numbers([capture_of(edge) for edge in edges]).tolist()
    return [
        without_blur(edge, offsets.get(number, 0.0))
        for edge, number in zip(edges, numbers, strict=True)
    ]


def _named(evidence: Sequence[Evidence]) -> list[Misfit]:
    """What is significant after Holm's correction (Scand. J. Statist. 6, 1979) and matters."""
    named: list[Misfit] = []
    least = 0.0
    for rank, one in enumerate(sorted(evidence, key=lambda one: one.p_value)):
        least = max(least, min((len(evidence) - rank) * one.p_value, 1.0))
        if least < NAMED_P and one.matters:
            named.append(Misfit(kind=one.kind, p_value=least, sentence=one.sentence))
    return named
