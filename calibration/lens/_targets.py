"""What Siemens stars tell, as part of a lens.json, beside the edges of the same photograph."""

from collections.abc import Sequence
from math import hypot, log, pi, sqrt
from typing import Literal

import numpy as np

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement
from calibration.robust import median_err
from calibration.sharpness import (
    EdgeFigures,
    EdgeMtf,
    MeasuredValue,
    find_star,
    mean_of_sectors,
    measure_star,
)
from simulation.arrays import FloatArray

_LEVELS = (("mtf50_cy_per_px", 0.5), ("mtf20_cy_per_px", 0.2), ("mtf10_cy_per_px", 0.1))
_NEAR, _NEAR_SHARE = 0.15, 0.75  # of contrast, and of the level
_STEPS = 6
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
    mtf, err = mean_of_sectors(found.mtf, found.mtf_err)
    known = np.isfinite(mtf)
    freq = found.freq_cy_per_px[known]
    levels = {name: found.smooth.crossing(level) for name, level in _LEVELS}
    whole = EdgeFigures.model_validate(
        {name: one and MeasuredValue(value=one[0], err=one[1]) for name, one in levels.items()}
    )
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
                figures=crossings(found.freq_cy_per_px, row, row_err, found.scale_err),
            )
            for turn, row, row_err in zip(found.sector_deg, found.mtf, found.mtf_err, strict=True)
        ),
    )


def _of_edges(edges: Sequence[EdgeMeasurement]) -> EdgeMtf | None:
    curves = [edge.esfr for edge in edges if edge.esfr is not None]
    if not curves:
        return None

    def median(freq: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = np.array([one.transform(freq).real for one in curves])
        errs = np.array([one.transform_err(freq) for one in curves])
        return np.median(values, axis=0), median_err(values, errs)

    return median


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


def crossings(freq: FloatArray, mtf: FloatArray, err: FloatArray, scale_err: float) -> EdgeFigures:
    """Return where a curve falls to a half, a fifth and a tenth, with errors."""
    found = {name: _crossing(freq, mtf, err, level, scale_err) for name, level in _LEVELS}
    return EdgeFigures.model_validate(found)


def _crossing(
    freq: FloatArray, mtf: FloatArray, err: FloatArray, level: float, scale_err: float
) -> MeasuredValue | None:
    """Fit the logarithm with a parabola about the level, and solve it."""
    near = np.isfinite(mtf) & (np.abs(np.nan_to_num(mtf) - level) < min(_NEAR, _NEAR_SHARE * level))
    if near.sum() < _FEWEST or not (mtf[near].min() < level < mtf[near].max()):
        return None
    middle = float(np.median(freq[near]))
    powers = (freq[near] - middle)[:, None] ** np.arange(3)
    model = mtf[near]
    for _ in range(_STEPS):  # Gauss and Newton: the logarithm of noisy values would be biased
        design = model[:, None] * powers / err[near][:, None]
        covariance = np.linalg.pinv(design.T @ design)
        left = (mtf[near] - model) / err[near]
        fit = covariance @ design.T @ (left + model * np.log(model) / err[near])
        model = np.exp(powers @ fit)
    roots = np.roots([fit[2], fit[1], fit[0] - log(level)])
    inside = [
        float(one.real)
        for one in roots
        if abs(one.imag) < 1e-12 and freq[near].min() <= one.real + middle <= freq[near].max()
    ]
    if not inside:
        return None
    away = min(inside, key=abs)
    slope = fit[1] + 2 * fit[2] * away
    there = away ** np.arange(3)
    by_noise = sqrt(float(there @ covariance @ there))
    return MeasuredValue(value=middle + away, err=hypot(by_noise, scale_err) / abs(float(slope)))
