"""Whether the edges agree with the model of the camera, and which of its faults they show.

What the edges tell against the model of one Gaussian camera: a test for each cause. Each test gives
a probability and how much it matters; what is significant and too small to matter is not named.
Captures, not edges, are the units of what captures share.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Literal

import numpy as np
from scipy.special import chdtrc, fdtrc, stdtr

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement
from calibration.psf._covariance import fit_variances
from calibration.psf._repeatability import (
    CaptureFit,
    SharedByCapture,
    by_capture,
    capture_numbers,
    capture_of,
    excess_variance,
    widths_of,
    without_blur,
)
from calibration.psf._softness import SoftnessFit, direction_columns, side_px
from simulation.arrays import BoolArray, FloatArray

MisfitKind = Literal["soft_target", "stage", "focus_drift", "focus_scatter", "shape", "edges"]


class HalvesCheck(StoredModel):
    """How well one half of the edges predicts the widths of the other.

    ``chi2_reduced`` is near 1 where the errors of the edges explain what is left.
    """

    chi2_reduced: float
    freedom: int
    p_value: float


class Misfit(StoredModel):
    """One thing that does not fit, in words, and how strongly it shows.

    ``p_value`` is after Holm's correction for all tests that were made.
    """

    kind: MisfitKind
    p_value: float
    sentence: str


class CrossValidation(StoredModel):
    """Whether the edges agree with one PSF, and the name of what does not fit.

    For ``edges`` every other edge of each capture predicts the rest, for ``heights`` the nearer
    half of the captures the further one, or every other capture the rest; null where a half does
    not determine the widths. ``p_values`` are before the correction; a test that could not be made
    is absent.
    """

    edges: HalvesCheck | None
    heights: HalvesCheck | None
    p_values: dict[MisfitKind, float]
    named: tuple[Misfit, ...]


def _check_edges(edges: Sequence[EdgeMeasurement]) -> HalvesCheck | None:
    """Predict every other edge of a capture from the rest; None where they do not determine it."""
    seen: dict[tuple[Hashable, str], int] = {}
    first = []
    for edge in edges:
        key = (capture_of(edge), edge.orientation)
        seen[key] = seen.get(key, len(seen)) + 1
        first.append(seen[key] % 2 == 0)
    return _check(edges, np.array(first, dtype=np.bool_))


def _check_heights(edges: Sequence[EdgeMeasurement]) -> HalvesCheck | None:
    """Predict the edges of the further captures from those of the nearer ones."""
    keys = [capture_of(edge) for edge in edges]
    height = {key: edge.height_mm for key, edge in zip(keys, edges, strict=True)}
    names = list(height)
    known = {value for value in height.values() if value is not None}
    if len(known) > 1 and None not in height.values():
        middle = float(np.median(sorted(known)))
        first = [(height[key] or 0.0) < middle for key in keys]
    elif len(names) > 1:
        first = [names.index(key) % 2 == 0 for key in keys]
    else:
        return None
    return _check(edges, np.array(first, dtype=np.bool_))


def _check(edges: Sequence[EdgeMeasurement], first: BoolArray) -> HalvesCheck | None:
    design = direction_columns(edges)
    if min(np.count_nonzero(first), np.count_nonzero(~first)) < design.shape[1]:
        return None
    for half in (design[first], design[~first]):
        if np.linalg.matrix_rank(half, tol=1e-3) < design.shape[1]:
            return None
    sigma, err = widths_of(edges)
    spread2 = (2 * sigma * err) ** 2
    values, covariance = _solved(design[first], sigma[first] ** 2, spread2[first])
    left = sigma[~first] ** 2 - design[~first] @ values
    # Edges that are predicted together share the errors of the prediction.
    whole = np.diag(spread2[~first]) + design[~first] @ covariance @ design[~first].T
    chi2 = float(left @ np.linalg.solve(whole, left))
    return HalvesCheck(
        chi2_reduced=chi2 / left.size, freedom=left.size, p_value=float(chdtrc(left.size, chi2))
    )


def _solved(
    design: FloatArray, squares: FloatArray, spread2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    weighted = design / spread2[:, None]
    covariance = np.linalg.inv(design.T @ weighted)
    return np.asarray(covariance @ (weighted.T @ squares)), np.asarray(covariance)


_DRIFT_P = 0.01
_DRIFT_LEAST = 0.01  # relative change over the range of heights
_FEWEST_FREEDOM = 3


class HeightGroup(StoredModel):
    """Width at one height, relative to the calibration as a whole in the same direction.

    ``sigma_x_px`` and ``sigma_y_px`` are medians over its vertical and horizontal edges.
    """

    height_mm: float
    edges: int
    relative_width: float
    relative_width_err: float
    sigma_x_px: float | None = None
    sigma_x_err_px: float | None = None
    sigma_y_px: float | None = None
    sigma_y_err_px: float | None = None


class HeightTrend(StoredModel):
    """Weighted straight line through the relative widths, and a test of any difference by height.

    ``p_value`` is that of the slope, two-sided; ``p_value_between`` is that of any difference
    between the heights, including a bend through best focus. ``is_drift`` says whether the
    change is significant (p below 0.01) and large enough to report (over 1 %).
    """

    slope_per_mm: float
    slope_err_per_mm: float
    p_value: float
    p_value_between: float
    is_drift: bool
    heights: tuple[HeightGroup, ...]

    @property
    def change(self) -> float:
        """Largest relative difference between two heights."""
        widths = [group.relative_width for group in self.heights]
        return max(widths) - min(widths)


def fit_height_trend(
    height_mm: FloatArray, relative_width: FloatArray, relative_width_err: FloatArray
) -> HeightTrend | None:
    """Fit a line to widths, relative to those expected, over heights; None for too few."""
    heights = np.unique(height_mm)
    freedom = height_mm.size - heights.size
    if heights.size < 2 or freedom < _FEWEST_FREEDOM:
        return None
    group = np.searchsorted(heights, height_mm)
    # The scatter of edges at one height beyond their errors is part of every error here.
    plain = np.bincount(group, relative_width) / np.bincount(group)
    scatter2 = excess_variance(
        relative_width - plain[group], relative_width_err, np.ones(group.size), freedom
    )
    weight = 1.0 / (relative_width_err**2 + scatter2)
    group_weight = np.bincount(group, weight)
    means = np.bincount(group, weight * relative_width) / group_weight
    centre = float(np.average(heights, weights=group_weight))
    middle = float(np.average(means, weights=group_weight))
    power = float(np.sum(group_weight * (heights - centre) ** 2))
    slope = float(np.sum(group_weight * (heights - centre) * (means - middle))) / power
    slope_err = 1.0 / sqrt(power)
    extra = heights.size - 1
    between = float(np.sum(group_weight * (means - middle) ** 2)) / extra
    p_value = float(2 * stdtr(freedom, -abs(slope) / slope_err))
    p_value_between = float(fdtrc(extra, freedom, between))
    is_sure = min(p_value, p_value_between) < _DRIFT_P
    return HeightTrend(
        slope_per_mm=slope,
        slope_err_per_mm=slope_err,
        p_value=p_value,
        p_value_between=p_value_between,
        is_drift=is_sure and float(np.ptp(means)) > _DRIFT_LEAST,
        heights=tuple(
            HeightGroup(
                height_mm=float(height),
                edges=int(np.count_nonzero(group == k)),
                relative_width=float(means[k]),
                relative_width_err=1.0 / sqrt(float(group_weight[k])),
            )
            for k, height in enumerate(heights)
        ),
    )


_SHAPE_FREQ = np.array([0.125, 0.25, 0.375])  # cy/px: a quarter, half and three quarters of Nyquist
_FEWEST_EDGES = 6
_WORTH_SHAPE = 0.006  # of a transfer
_WORTH_WIDTH = 0.01  # of a width
_WORTH_STAGE = 0.003  # of a distance
_WORTH_EDGES = 0.015  # of a width


@dataclass(frozen=True, slots=True, kw_only=True)
class _Evidence:
    """What speaks against the model: its kind, its probability, whether it matters, a sentence."""

    kind: MisfitKind
    p_value: float
    matters: bool
    sentence: str


def _soft_target(softness: SoftnessFit | None) -> _Evidence | None:
    """Test whether the target is soft."""
    if softness is None:
        return None
    found = softness.document
    share = 100 * sqrt(max(found.variance_px2, 0.0))
    blur = f"{share / 100:.2f} px in the nearest capture"
    if found.sigma_mm is not None:
        blur += f" ({found.sigma_mm:.3f} mm)"
    return _Evidence(
        kind="soft_target",
        p_value=found.p_value if found.is_removed else 1.0,
        matters=found.is_removed,
        sentence=f"the edge target itself is soft: {blur}, judging by how the widths grow with "
        "its scale; this blur is subtracted, so sigma is that of the camera",
    )


def _stage(edges: Sequence[EdgeMeasurement]) -> _Evidence | None:
    """Test whether the heights that were read agree with the sizes of squares in the captures."""
    captures = list(by_capture(edges).values())
    known = [
        (some[0].height_mm, side)
        for some in captures
        if some[0].height_mm is not None and (side := side_px(some)) is not None
    ]
    if len(known) < 4 or len({height for height, _ in known}) < 3:
        return None
    height, side = np.array(known, dtype=np.float64).T
    design = np.column_stack([height, np.ones_like(height)])
    root = side  # relative errors of distances are alike
    values = np.linalg.lstsq(design * root[:, None], np.ones_like(side), rcond=None)[0]
    left = design @ values * side - 1
    freedom = height.size - 2
    relative = sqrt(float(left @ left) / freedom)
    err = _side_err(captures)
    p_value = float(fdtrc(freedom, _SIDE_FREEDOM, (relative / err) ** 2))
    away_mm = relative * float(np.mean(height + values[1] / values[0]))
    return _Evidence(
        kind="stage",
        p_value=p_value,
        matters=relative > _WORTH_STAGE,
        sentence=f"the heights do not fit the size of the target in the captures: they scatter by "
        f"{away_mm:.2g} mm ({100 * relative:.1f} % of the distance); check the stage",
    )


_SIDE_FREEDOM = 30.0


def _side_err(captures: Sequence[Sequence[EdgeMeasurement]]) -> float:
    """Relative error of the side of a square, twice that of the widths of its edges."""
    errs = []
    for some in captures:
        side = side_px(some)
        if side is not None:
            mean_px = sqrt(float(np.mean([edge.sigma_err_px**2 for edge in some])))
            errs.append(2 * mean_px / side)
    return max(sqrt(float(np.mean(np.square(errs)))), 1e-6)


def _focus_drift(edges: Sequence[EdgeMeasurement], shared: SharedByCapture) -> _Evidence | None:
    """Test whether the variance changes along a straight line over the heights."""
    height = _height_column(edges)
    if height is None:
        return None
    sigma, err = widths_of(edges)
    design = np.column_stack([direction_columns(edges), height])
    if np.linalg.matrix_rank(design, tol=1e-6) < design.shape[1]:
        return None
    fit = fit_variances(design, sigma, err, shared=shared, is_resampled=False)
    slope, slope_err = float(fit.values[-1]), sqrt(float(fit.covariance[-1, -1]))
    last = np.eye(fit.values.size)[-1]
    freedom = float(sigma.size - design.shape[1])
    if fit.by_capture is not None and fit.is_by_capture:
        freedom = min(freedom, fit.by_capture.freedom(last))
    change = slope * float(np.ptp(height)) / (2 * float(np.mean(sigma**2)))
    return _Evidence(
        kind="focus_drift",
        p_value=float(2 * stdtr(freedom, -abs(slope) / slope_err)),
        matters=abs(change) > _WORTH_WIDTH,
        sentence=f"the width changes by {100 * abs(change):.1f} % over the heights: the focus "
        "drifts; calibrate at one height or refocus",
    )


def _focus_scatter(fit: CaptureFit | None, width_px: float) -> _Evidence | None:
    """Test whether captures differ by more than their edges do."""
    if fit is None or fit.is_single:
        return None
    scatter = sqrt(fit.scatter2_px4)
    return _Evidence(
        kind="focus_scatter",
        p_value=fit.p_value,
        matters=scatter / (2 * width_px**2) > _WORTH_WIDTH,
        sentence=f"the focus scatters between captures by {scatter:.3f} px^2 "
        f"({100 * scatter / (2 * width_px**2):.1f} % of sigma); the errors include this: more "
        "captures, or a locked focus, make them smaller",
    )


def _shape(edges: Sequence[EdgeMeasurement]) -> _Evidence | None:
    """Test whether a Gaussian lens with a pixel passes what the edges' own curves show."""
    rows = [_off_gaussian(edge) for edge in edges if edge.esfr is not None]
    known = np.array([row for row in rows if row is not None])
    if len(known) < _FEWEST_EDGES:
        return None
    mean, err = known.mean(axis=0), known.std(axis=0, ddof=1) / sqrt(len(known))
    err = np.maximum(err, 1e-6)
    p_values = 2 * stdtr(len(known) - 1, -np.abs(mean) / err)
    # Only what matters is tested: where the most significant is too small, the largest counts.
    worst = int(np.argmax(np.abs(mean)))
    return _Evidence(
        kind="shape",
        p_value=float(min(p_values.size * p_values[worst], 1.0)),
        matters=abs(float(mean[worst])) > _WORTH_SHAPE,
        sentence=f"a Gaussian does not fit this lens: at {_SHAPE_FREQ[worst]:.3f} cy/px the edges "
        f"differ from it by {100 * mean[worst]:+.1f} % of contrast; use the measured transfer "
        "(method all-angles), not the Gaussian",
    )


def _off_gaussian(edge: EdgeMeasurement) -> FloatArray | None:
    """Measured transfer less that of the fitted Gaussian, at the frequencies of the test."""
    sigma_px = edge.optical_sigma_px
    if sigma_px is None or edge.esfr is None:
        return None
    cosine, sine = np.cos(edge.normal_rad), np.sin(edge.normal_rad)
    pixel = np.sinc(_SHAPE_FREQ * cosine) * np.sinc(_SHAPE_FREQ * sine)
    gauss = np.exp(-2 * (pi * sigma_px * _SHAPE_FREQ) ** 2) * pixel
    return np.asarray(edge.esfr.transform(_SHAPE_FREQ).real - gauss)


def _edges_apart(p_value: float, scatter_px: float, width_px: float) -> _Evidence:
    """Name edges that differ within captures, from how badly half of them predicts the rest."""
    return _Evidence(
        kind="edges",
        p_value=p_value,
        matters=scatter_px / width_px > _WORTH_EDGES,
        sentence=f"edges of one capture differ by {100 * scatter_px / width_px:.1f} % beyond their "
        "errors: the PSF changes over the frame, or edges are rough; the errors include this",
    )


def _height_column(edges: Sequence[EdgeMeasurement]) -> FloatArray | None:
    """Heights about their middle over their range; None with fewer than three."""
    heights = [edge.height_mm for edge in edges if edge.height_mm is not None]
    if len(heights) < len(edges) or len(set(heights)) < 3:
        return None
    height = np.array(heights)
    return np.asarray((height - height.mean()) / float(np.ptp(height)))


def shared_of(edges: Sequence[EdgeMeasurement], softness: SoftnessFit | None) -> SharedByCapture:
    """Return what the captures of these edges share."""
    if softness is None:
        return SharedByCapture.of(edges)
    return SharedByCapture.of(edges, softness.columns, softness.precision)


def _scatter_beside(
    edges: Sequence[EdgeMeasurement], columns: FloatArray | None, shared: SharedByCapture
) -> CaptureFit | None:
    """Fit the scatter between captures beside further columns of the model."""
    sigma, err = widths_of(edges)
    design = direction_columns(edges)
    if columns is not None:
        design = np.column_stack([design, columns])
    return fit_variances(design, sigma, err, shared=shared, is_resampled=False).by_capture


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

    ``adjusted`` are the edges without the softness of the target; ``scatter_px`` is that of widths
    within captures beyond their errors.
    """
    width_px = float(np.sqrt(np.mean([edge.sigma_px**2 for edge in adjusted])))
    edges, heights = _check_edges(_levelled(adjusted, focus)), _check_heights(adjusted)
    found: list[_Evidence | None] = [_soft_target(softness), _stage(seen), _shape(seen)]
    shared = shared_of(adjusted, softness)
    drift = _focus_drift(adjusted, shared)
    # What drifts differs between captures as well: scatter is what is left beside the drift.
    is_drift = drift is not None and drift.matters and drift.p_value < NAMED_P / len(found)
    column = _height_column(adjusted) if is_drift else None
    found += [drift, _focus_scatter(_scatter_beside(adjusted, column, shared), width_px)]
    if edges is not None:
        found.append(_edges_apart(edges.p_value, scatter_px, width_px))
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
    numbers = capture_numbers(edges).tolist()
    return [
        without_blur(edge, offsets.get(number, 0.0))
        for edge, number in zip(edges, numbers, strict=True)
    ]


def _named(evidence: Sequence[_Evidence]) -> list[Misfit]:
    """What is significant after Holm's correction (Scand. J. Statist. 6, 1979) and matters."""
    named: list[Misfit] = []
    least = 0.0
    for rank, one in enumerate(sorted(evidence, key=lambda one: one.p_value)):
        least = max(least, min((len(evidence) - rank) * one.p_value, 1.0))
        if least < NAMED_P and one.matters:
            named.append(Misfit(kind=one.kind, p_value=least, sentence=one.sentence))
    return named
