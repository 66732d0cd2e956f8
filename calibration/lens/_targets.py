"""What Siemens stars tell, as part of a lens.json, beside the edges of the same photograph."""

from collections.abc import Callable, Sequence
from math import hypot, pi, sqrt
from typing import Literal

import numpy as np

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement
from calibration.sharpness import EdgeFigures, MeasuredValue, StarSfr, find_star, measure_star
from simulation.arrays import FloatArray

_LEVELS = (("mtf50_cy_per_px", 0.5), ("mtf20_cy_per_px", 0.2), ("mtf10_cy_per_px", 0.1))
_NEAR = 0.15  # of contrast: about the level, the curve is a parabola
_FEWEST = 4


class SectorFigures(StoredModel):
    """One eighth of a star, in the direction ``direction_deg`` from its centre (+x, y down).

    Its figures are of the contrast across that direction.
    """

    direction_deg: float
    figures: EdgeFigures


class StarFigures(StoredModel):
    """Contrast by frequency of a Siemens star, mean of its sectors, and each sector's figures.

    ``scaled_by`` says what contrast 1 is by: the edges of the photograph, or the star's own lowest
    frequencies. ``mtf50_over_edges`` is the ratio to the edges of the same photograph, None without
    any.
    """

    image: str
    x_px: float
    y_px: float
    cycles: int
    radius_px: float
    scaled_by: Literal["edges", "extrapolation"]
    freq_cy_per_px: tuple[float, ...]
    mtf: tuple[float, ...]
    mtf_err: tuple[float, ...]
    figures: EdgeFigures
    mtf50_over_edges: MeasuredValue | None = None
    sectors: tuple[SectorFigures, ...]


def star_figures(
    image: str, image_dn: FloatArray, edges: Sequence[EdgeMeasurement]
) -> StarFigures | None:
    """Find and measure a Siemens star; None if the photograph shows none.

    ``edges`` are those of the same photograph that are used, which may be none.
    """
    place = find_star(image_dn)
    if place is None:
        return None
    by_edges = _of_edges(edges)
    found = measure_star(image_dn, place, by_edges)
    if found is None:
        return None
    mtf, err = _mean_of_sectors(found)
    known = np.isfinite(mtf)
    freq = found.freq_cy_per_px[known]
    whole = _crossings(freq, mtf[known], err[known], found.scale_err)
    half = whole.mtf50_cy_per_px
    return StarFigures(
        image=image,
        x_px=place.x_px,
        y_px=place.y_px,
        cycles=place.cycles,
        radius_px=place.outer_px,
        scaled_by=found.scaled_by,
        freq_cy_per_px=tuple(freq.tolist()),
        mtf=tuple(mtf[known].tolist()),
        mtf_err=tuple(err[known].tolist()),
        figures=whole,
        mtf50_over_edges=None if half is None else _ratio(half, edges),
        sectors=tuple(
            SectorFigures(
                direction_deg=turn,
                figures=_crossings(found.freq_cy_per_px, row, row_err, found.scale_err),
            )
            for turn, row, row_err in zip(found.sector_deg, found.mtf, found.mtf_err, strict=True)
        ),
    )


def _of_edges(edges: Sequence[EdgeMeasurement]) -> Callable[[FloatArray], FloatArray] | None:
    curves = [edge.esfr for edge in edges if edge.esfr is not None]
    if not curves:
        return None
    return lambda freq: np.median([one.transform(freq).real for one in curves], axis=0)


def _ratio(half: MeasuredValue, edges: Sequence[EdgeMeasurement]) -> MeasuredValue | None:
    """MTF50 of the star over the median of the edges."""
    known = np.array(
        [
            (edge.esfr_mtf50_cy_per_px, edge.esfr_mtf50_err_cy_per_px)
            for edge in edges
            if edge.esfr_mtf50_cy_per_px is not None and edge.esfr_mtf50_err_cy_per_px is not None
        ]
    )
    if not known.size:
        return None
    middle = float(np.median(known[:, 0]))
    spread = max(float(np.std(known[:, 0])), float(np.sqrt(np.mean(known[:, 1] ** 2))))
    value = half.value / middle
    relative = hypot(half.err / half.value, sqrt(pi / 2) * spread / sqrt(len(known)) / middle)
    return MeasuredValue(value=value, err=value * relative)


def _mean_of_sectors(found: StarSfr) -> tuple[FloatArray, FloatArray]:
    """Mean over the sectors in which a frequency was seen; NaN where fewer than half are."""
    seen = np.isfinite(found.mtf)
    count = seen.sum(axis=0)
    enough = 2 * count >= len(found.mtf)
    mean = np.where(seen, found.mtf, 0.0).sum(axis=0) / np.maximum(count, 1)
    err = np.sqrt((np.where(seen, found.mtf_err, 0.0) ** 2).sum(axis=0)) / np.maximum(count, 1)
    return np.where(enough, mean, np.nan), np.where(enough, err, np.nan)


def _crossings(freq: FloatArray, mtf: FloatArray, err: FloatArray, scale_err: float) -> EdgeFigures:
    """Where a curve falls to a half, a fifth and a tenth, with errors."""
    found = {name: _crossing(freq, mtf, err, level, scale_err) for name, level in _LEVELS}
    return EdgeFigures.model_validate(found)


def _crossing(
    freq: FloatArray, mtf: FloatArray, err: FloatArray, level: float, scale_err: float
) -> MeasuredValue | None:
    """Fit a parabola about the level, and solve it."""
    near = np.isfinite(mtf) & (np.abs(np.nan_to_num(mtf) - level) < min(_NEAR, 0.9 * level))
    if near.sum() < _FEWEST or not (mtf[near].min() < level < mtf[near].max()):
        return None
    middle = float(np.median(freq[near]))
    design = (freq[near] - middle)[:, None] ** np.arange(3) / err[near][:, None]
    covariance = np.linalg.pinv(design.T @ design)
    fit = covariance @ design.T @ (mtf[near] / err[near])
    roots = np.roots([fit[2], fit[1], fit[0] - level])
    inside = [
        float(one.real)
        for one in roots
        if abs(one.imag) < 1e-12 and freq[near].min() <= one.real + middle <= freq[near].max()
    ]
    if not inside:
        return None
    away = min(inside, key=abs)
    slope = fit[1] + 2 * fit[2] * away
    powers = away ** np.arange(3)
    by_noise = sqrt(float(powers @ covariance @ powers))
    spread = hypot(by_noise, scale_err * level) / abs(float(slope))
    return MeasuredValue(value=middle + away, err=spread)
