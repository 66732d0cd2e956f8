"""Through-focus: where each part of the field is sharpest, and how far one may be from there.

An edge is followed through photographs at several focus positions. The logarithm of its contrast at
one frequency is a smooth function of the position, parabolic about the best focus whatever the
lens: a polynomial is fitted to it, of the lowest degree that the contrasts allow. Its largest value
is the best focus, and where it falls to a stated contrast are the ends of the depth of field.

Over the field, the best focus of an edge whose normal is turned by ``a`` from the radius is
``z = z0 + tilt_x x + tilt_y y + r^2 (T cos^2 a + S sin^2 a)``: blur that grows with the square of
the distance from either focus has its least across the edge there. Over an edge of some length, the
mean counts. T and S are the tangential and the sagittal field curvature (third-order aberrations;
Born and Wolf, "Principles of optics", section 5.3), r is 1 in the corners, x and y go from -1/2 to
1/2 over the picture.

That least blur is not 0 where the foci differ: its variance is ``r^4 (T - S)^2 cos^2 a sin^2 a``
times that of a mm of defocus. Where the picture grows by a share ``g`` a mm, edges move outwards to
more of it, and their best focus lies before ``z`` by ``2 g r^4 (T - S)^2 cos^2 a sin^2 a``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import atan, cos, degrees, hypot, log, pi, radians, sin, sqrt
from typing import Literal, NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from scipy.special import chdtrc

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement
from calibration.estimate import Estimate
from calibration.robust import median_err
from calibration.sharpness import MeasuredValue, Picture
from simulation.arrays import FloatArray

FocusAxis = Literal["focus", "height"]

_FEWEST_POSITIONS = 5
_FEWEST_POINTS = 7  # five parameters, and two to show scatter
_KEPT = 0.3  # of the largest contrast: below, a defocused lens no longer blurs like a parabola
_BEYOND = 0.8  # of the stated contrast: its crossing must lie between measured positions
_LEAST_BEYOND = 0.1  # of the largest contrast: nearer to the first zero the logarithm dives
_SIGMAS_SEEN = 4.0
_CURVED_SIGMAS = 5.0
_DEGREES = (2, 3, 4, 5, 6)
_IMPROVED_P = 0.01
_FLOOR = 1e-3  # relative: what the contrasts of one edge scatter by beside noise
_OF_ESFR = 5e-3  # relative: what the contrasts of all edges may be off by together
_SAME_TURN_DEG = 4.0
_STEP_SHARE, _SETTLED_SHARE, _SETTLED_PX = 0.06, 0.01, 6.0  # of the diagonal
_CONDITION_MOST = 1e4
_FIELD_STEPS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedContrast:
    """The contrast, and its frequency, that focus is judged by."""

    contrast: float
    freq_cy_per_px: float

    def __post_init__(self) -> None:
        if not 0 < self.contrast < 1:
            raise ValueError(f"contrast must lie between 0 and 1, got {self.contrast}")
        if not 0 < self.freq_cy_per_px <= 1:
            raise ValueError(f"freq_cy_per_px must lie between 0 and 1, got {self.freq_cy_per_px}")


class FocusPoint(StoredModel):
    """One edge through focus.

    ``best_mm`` is where its contrast is the largest, ``contrast`` that contrast. ``nearest_mm`` and
    ``farthest_mm`` are the positions between which the stated contrast is reached, ``depth_mm`` is
    their difference; None if an end lies beyond the positions, or the contrast is never reached.
    ``positions_mm`` and ``contrasts`` are what was measured.
    """

    x_px: float
    y_px: float
    angle_deg: float
    length_px: float
    best_mm: MeasuredValue
    contrast: MeasuredValue
    nearest_mm: MeasuredValue | None = None
    farthest_mm: MeasuredValue | None = None
    depth_mm: MeasuredValue | None = None
    positions_mm: tuple[float, ...]
    contrasts: tuple[float, ...]
    contrast_errs: tuple[float, ...]
    polynomial: tuple[float, ...]

    def curve(self, position_mm: FloatArray) -> FloatArray:
        """Return the fitted contrast at positions between those that were measured."""
        middle, scale, *coefficients = self.polynomial
        away = (np.asarray(position_mm) - middle) / scale
        return np.asarray(np.exp(polynomial.polyval(away, coefficients)))


class FocusField(StoredModel):
    """How the best focus changes over the picture, in mm of focus position.

    ``tilt_x_mm`` and ``tilt_y_mm`` are its change from left to right and from top to bottom,
    ``tilt_mm`` that along the steepest line; ``tilt_deg`` is the turn of the sensor, if the
    positions are the sensor's and the pixel pitch is known. ``tangential_mm`` and ``sagittal_mm``
    are its change from the centre to the corners, ``curvature_mm`` their mean, ``astigmatism_mm``
    their difference. ``scatter_mm`` is what the points scatter by beyond their errors.
    """

    tilt_x_mm: MeasuredValue
    tilt_y_mm: MeasuredValue
    tilt_mm: MeasuredValue
    tilt_deg: MeasuredValue | None = None
    tangential_mm: MeasuredValue
    sagittal_mm: MeasuredValue
    curvature_mm: MeasuredValue
    astigmatism_mm: MeasuredValue
    scatter_mm: float


class ThroughFocus(StoredModel):
    """Best focus of each field point, and the depth of field, by the contrast at one frequency.

    Parameters
    ----------
    axis
        What was moved: the focus (sensor or lens, along the axis), or the height of the camera.
    contrast, freq_cy_per_px
        The contrast, and its frequency, that the depth is stated for.
    best_mm
        Best focus at the centre of the picture; without ``field`` the median of the points.
    depth_mm
        Depth over which an edge has the stated contrast, median of the points.
    common_depth_mm
        Depth over which all of them have it at once; negative where they never do.
    field
        Tilt, curvature and astigmatism; None where ``no_field_because`` says why.
    """

    axis: FocusAxis
    contrast: float
    freq_cy_per_px: float
    best_mm: MeasuredValue
    depth_mm: MeasuredValue | None = None
    common_depth_mm: MeasuredValue | None = None
    field: FocusField | None = None
    no_field_because: str | None = None
    points: tuple[FocusPoint, ...]

    def limits(self) -> dict[str, Estimate]:
        """Return the figures that a limits file bounds under ``[focus]``."""
        found = {}
        if self.field is not None:
            found["focus.max_tilt_mm"] = _modulus(self.field.tilt_mm)
            found["focus.max_curvature_mm"] = _modulus(self.field.curvature_mm)
            found["focus.max_astigmatism_mm"] = _modulus(self.field.astigmatism_mm)
        if self.depth_mm is not None:
            found["focus.min_depth_mm"] = self.depth_mm.estimate
        if self.common_depth_mm is not None:
            found["focus.min_common_depth_mm"] = self.common_depth_mm.estimate
        return found


def _modulus(known: MeasuredValue) -> Estimate:
    low, high = sorted((abs(known.estimate.low), abs(known.estimate.high)))
    interval = (0.0 if known.estimate.low <= 0 <= known.estimate.high else low, high)
    return Estimate(value=abs(known.value), err=known.err, interval_95=interval)


def through_focus(
    edges: Sequence[EdgeMeasurement],
    positions_mm: Mapping[str, float],
    picture: Picture,
    stated: StatedContrast,
    axis: FocusAxis,
) -> ThroughFocus | None:
    """Return the best focus over the field and the depth of field; None if no edge has a best one.

    Parameters
    ----------
    edges
        Those of all photographs, of which the ones that are used and have an e-SFR count.
    positions_mm
        Position of each photograph, by its name; five different ones at least.
    picture
        Size of the photographs and pixel pitch.
    stated
        Contrast and frequency of the depth of field.
    axis
        What was moved.
    """
    width, height = picture.width_px, picture.height_px
    if width is None or height is None or len(set(positions_mm.values())) < _FEWEST_POSITIONS:
        return None
    tracks = _followed(edges, positions_mm, hypot(width, height))
    points = tuple(point for track in tracks if (point := _point(track, stated)) is not None)
    if not points:
        return None
    best = np.array([one.best_mm.value for one in points])
    errs = np.array([one.best_mm.err for one in points])
    middle = MeasuredValue(value=float(np.median(best)), err=_median_err(best, errs))
    found, missing = _field_of(points, picture, axis, _growth_per_mm(tracks, picture))
    short = sum(len(one.edges) < _FEWEST_POSITIONS for one in tracks)
    if missing is not None and short:
        missing += (
            f"; {short} more were followed through fewer than {_FEWEST_POSITIONS} positions, as "
            "where steps are so wide that edges blur away or move between them"
        )
    return ThroughFocus(
        axis=axis,
        contrast=stated.contrast,
        freq_cy_per_px=stated.freq_cy_per_px,
        best_mm=middle if found is None else found.centre_mm,
        depth_mm=_median_depth(points, stated.contrast),
        common_depth_mm=_common_depth(points, stated.contrast),
        field=None if found is None else found.field,
        no_field_because=missing,
        points=points,
    )


@dataclass(slots=True)
class _Track:
    """One edge through the photographs, in the order of their positions."""

    edges: list[EdgeMeasurement] = field(default_factory=list)
    positions_mm: list[float] = field(default_factory=list)

    def add(self, edge: EdgeMeasurement, position_mm: float) -> None:
        self.edges.append(edge)
        self.positions_mm.append(position_mm)

    @property
    def last(self) -> EdgeMeasurement:
        return self.edges[-1]


def _followed(
    edges: Sequence[EdgeMeasurement], positions_mm: Mapping[str, float], diagonal_px: float
) -> list[_Track]:
    """Follow every edge from photograph to photograph, though the picture may grow or shrink."""
    by_image: dict[str, list[EdgeMeasurement]] = {}
    for edge in edges:
        if edge.is_used and edge.esfr is not None and edge.image in positions_mm:
            by_image.setdefault(edge.image, []).append(edge)
    tracks: list[_Track] = []
    for image in sorted(by_image, key=lambda name: positions_mm[name]):
        here = by_image[image]
        found = _matched(tracks, here, _STEP_SHARE * diagonal_px, _STILL)
        moved = _movement([(tracks[one].last, here[other]) for one, other in found])
        settled = max(_SETTLED_SHARE * diagonal_px, _SETTLED_PX)
        found = _matched(tracks, here, settled, moved)
        for one, other in found:
            tracks[one].add(here[other], positions_mm[image])
        taken = {other for _, other in found}
        for number, edge in enumerate(here):
            if number not in taken:
                tracks.append(_Track([edge], [positions_mm[image]]))
    return tracks


_Movement = tuple[float, float, float]
"""Scale, and shift along x and y."""
_STILL: _Movement = (1.0, 0.0, 0.0)


def _matched(
    tracks: Sequence[_Track], edges: Sequence[EdgeMeasurement], reach_px: float, moved: _Movement
) -> list[tuple[int, int]]:
    """Pairs of a track and an edge that are each other's nearest, with the same direction."""
    if not tracks or not edges:
        return []
    scale, shift_x, shift_y = moved
    before = np.array([(one.last.x_px, one.last.y_px) for one in tracks])
    before = scale * before + np.array([shift_x, shift_y])
    after = np.array([(one.x_px, one.y_px) for one in edges])
    apart = np.hypot(*(before[:, None] - after[None]).transpose(2, 0, 1))
    turn = np.subtract.outer(
        [one.last.angle_deg for one in tracks], [one.angle_deg for one in edges]
    )
    turn = np.abs((turn + 90) % 180 - 90)
    rises = np.not_equal.outer([_rises(one.last) for one in tracks], [_rises(one) for one in edges])
    apart[(turn > _SAME_TURN_DEG) | rises] = np.inf
    nearest = apart.argmin(axis=1)
    return [
        (number, int(other))
        for number, other in enumerate(nearest)
        if apart[number, other] <= reach_px and apart[:, other].argmin() == number
    ]


def _rises(edge: EdgeMeasurement) -> bool:
    return edge.levels_dn is None or edge.levels_dn[0] < edge.levels_dn[1]


def _movement(pairs: Sequence[tuple[EdgeMeasurement, EdgeMeasurement]]) -> _Movement:
    """Scale and shift between two photographs, without what half of the pairs do not agree with."""
    if len(pairs) < 3:
        return _STILL
    before = np.array([(one.x_px, one.y_px) for one, _ in pairs])
    after = np.array([(one.x_px, one.y_px) for _, one in pairs])
    kept = np.ones(len(pairs), dtype=np.bool_)
    scale, shift = 1.0, np.zeros(2)
    for _ in range(5):
        middle, other = before[kept].mean(axis=0), after[kept].mean(axis=0)
        spread = float(np.sum((before[kept] - middle) ** 2))
        if spread > 0:
            scale = float(np.sum((before[kept] - middle) * (after[kept] - other)) / spread)
        shift = other - scale * middle
        left = np.hypot(*(after - scale * before - shift).T)
        kept = left <= max(3 * float(np.median(left)), 1.0)
        if kept.sum() < 3:
            break
    return scale, float(shift[0]), float(shift[1])


class _Curve(NamedTuple):
    """A polynomial of the logarithm of the contrast by ``(position - middle_mm) / scale_mm``."""

    middle_mm: float
    scale_mm: float
    first: float
    last: float
    coefficients: FloatArray
    covariance: FloatArray

    def at(self, away: float) -> float:
        return float(polynomial.polyval(away, self.coefficients))

    def err_at(self, away: float) -> float:
        powers = away ** np.arange(self.coefficients.size)
        return sqrt(float(powers @ self.covariance @ powers))

    def slope(self, away: float, order: int = 1) -> float:
        return float(polynomial.polyval(away, polynomial.polyder(self.coefficients, order)))

    def place_gradient(self, away: float, *, is_peak: bool) -> FloatArray:
        """Derivatives by the coefficients of where the curve peaks or crosses a level."""
        order = np.arange(self.coefficients.size)
        if is_peak:
            powers = order * away ** np.maximum(order - 1, 0)
            return np.asarray(-powers / self.slope(away, 2))
        return np.asarray(-(away**order) / self.slope(away))

    def place(self, away: float, gradient: FloatArray) -> MeasuredValue:
        err = self.scale_mm * sqrt(float(gradient @ self.covariance @ gradient))
        return MeasuredValue(value=self.middle_mm + self.scale_mm * away, err=err)


def _point(track: _Track, stated: StatedContrast) -> FocusPoint | None:
    """The through-focus figures of an edge; None if it is not sharpest between two positions."""
    freq = np.array([stated.freq_cy_per_px])
    curves = [edge.esfr for edge in track.edges if edge.esfr is not None]
    contrasts = np.array([float(one.transform(freq).real[0]) for one in curves])
    errs = np.array([float(one.transform_err(freq)[0]) for one in curves])
    positions = np.array(track.positions_mm)
    kept = _about_peak(positions, contrasts, errs, stated.contrast)
    if np.unique(positions[kept]).size < _FEWEST_POSITIONS:
        return None
    curve = _fitted(positions[kept], contrasts[kept], errs[kept])
    away = _peak_of(curve)
    if away is None:
        return None
    best = curve.place(away, curve.place_gradient(away, is_peak=True))
    contrast = float(np.exp(curve.at(away)))
    nearest = min(range(positions.size), key=lambda n: abs(positions[n] - best.value))
    edge = track.edges[nearest]
    return FocusPoint(
        x_px=edge.x_px,
        y_px=edge.y_px,
        angle_deg=edge.angle_deg,
        length_px=edge.length_px,
        best_mm=best,
        contrast=MeasuredValue(value=contrast, err=contrast * curve.err_at(away)),
        **_depth(curve, away, stated.contrast),
        positions_mm=tuple(positions.tolist()),
        contrasts=tuple(contrasts.tolist()),
        contrast_errs=tuple(errs.tolist()),
        polynomial=(curve.middle_mm, curve.scale_mm, *curve.coefficients.tolist()),
    )


def _about_peak(
    positions_mm: FloatArray, contrasts: FloatArray, errs: FloatArray, stated: float
) -> FloatArray:
    """Indices of the contrasts about the largest one, up to the first beyond what is needed."""
    order = np.argsort(positions_mm, kind="stable")
    levels = contrasts[order]
    top = int(np.argmax(levels))
    most = float(levels[top])
    least = min(_KEPT * most, _BEYOND * stated)
    seen = (levels > _SIGMAS_SEEN * errs[order]) & (levels > _LEAST_BEYOND * most)
    kept = [top]
    for step in (-1, 1):
        number = top + step
        while 0 <= number < levels.size and seen[number]:
            kept.append(number)
            if levels[number] < least:
                break
            number += step
    return np.asarray(order[np.sort(np.array(kept))])


def _fitted(positions_mm: FloatArray, contrasts: FloatArray, errs: FloatArray) -> _Curve:
    """Fit the lowest degree than which no higher one is better by more than chance."""
    middle = float(positions_mm[np.argmax(contrasts)])
    scale = float(np.ptp(positions_mm)) / 2
    away = (positions_mm - middle) / scale
    weights = 1.0 / np.hypot(errs / contrasts, _FLOOR)
    different = np.unique(positions_mm).size
    orders = [one for one in _DEGREES if one <= different - 3] or [2]
    fits = {one: _weighted(away, np.log(contrasts), weights, one) for one in orders}
    count = positions_mm.size
    free = {one: max(count - one - 1, 1) for one in orders}
    top = orders[-1]
    per_degree = max(fits[top].chi2 / free[top], 1.0)
    chosen = next(
        one
        for one in orders
        if all(
            chdtrc(more - one, (fits[one].chi2 - fits[more].chi2) / per_degree) > _IMPROVED_P
            for more in orders
            if more > one
        )
    )
    best = fits[chosen]
    return _Curve(
        middle_mm=middle,
        scale_mm=scale,
        first=float(away.min()),
        last=float(away.max()),
        coefficients=best.coefficients,
        covariance=best.covariance * max(best.chi2 / free[chosen], 1.0),
    )


class _Fit(NamedTuple):
    coefficients: FloatArray
    covariance: FloatArray
    chi2: float


def _weighted(away: FloatArray, levels: FloatArray, weights: FloatArray, order: int) -> _Fit:
    design = weights[:, None] * away[:, None] ** np.arange(order + 1)
    return _least_squares(design, weights * levels)


def _least_squares(design: FloatArray, values: FloatArray) -> _Fit:
    found = np.asarray(np.linalg.lstsq(design, values, rcond=None)[0], dtype=np.float64)
    left = values - design @ found
    covariance = np.asarray(np.linalg.pinv(design.T @ design), dtype=np.float64)
    return _Fit(found, covariance, float(left @ left))


def _peak_of(curve: _Curve) -> float | None:
    """Where the curve is largest, if it surely bends down there, between the positions."""
    slopes = polynomial.polyder(curve.coefficients)
    roots = polynomial.polyroots(slopes)
    inside = [
        float(one.real)
        for one in roots
        if abs(one.imag) < 1e-9 and curve.first < one.real < curve.last
        and curve.slope(float(one.real), 2) < 0
    ]  # fmt: skip
    if not inside:
        return None
    away = max(inside, key=curve.at)
    order = np.arange(curve.coefficients.size)
    bend = order * (order - 1) * away ** np.maximum(order - 2, 0)
    err = sqrt(float(bend @ curve.covariance @ bend))
    return away if -curve.slope(away, 2) > _CURVED_SIGMAS * err else None


def _depth(curve: _Curve, away: float, contrast: float) -> dict[str, MeasuredValue]:
    """The ends between which the contrast is reached, and their distance."""
    level = log(contrast)
    if curve.at(away) <= level:
        return {}
    shifted = curve.coefficients.copy()
    shifted[0] -= level
    roots = polynomial.polyroots(shifted)
    real = [float(one.real) for one in roots if abs(one.imag) < 1e-9]
    below = [one for one in real if curve.first <= one < away]
    above = [one for one in real if away < one <= curve.last]
    found = {}
    ends = {}
    for name, sides, choose in (("nearest_mm", below, max), ("farthest_mm", above, min)):
        if sides:
            ends[name] = choose(sides)
            gradient = curve.place_gradient(ends[name], is_peak=False)
            found[name] = curve.place(ends[name], gradient)
    if len(ends) == 2:
        gradient = curve.place_gradient(ends["farthest_mm"], is_peak=False)
        gradient = gradient - curve.place_gradient(ends["nearest_mm"], is_peak=False)
        err = curve.scale_mm * sqrt(float(gradient @ curve.covariance @ gradient))
        depth = curve.scale_mm * (ends["farthest_mm"] - ends["nearest_mm"])
        found["depth_mm"] = MeasuredValue(value=depth, err=err)
    return found


class _Found(NamedTuple):
    centre_mm: MeasuredValue
    field: FocusField


def _field_of(
    points: Sequence[FocusPoint], picture: Picture, axis: FocusAxis, growth_per_mm: float
) -> tuple[_Found | None, str | None]:
    """Fit tilt and both curvatures to the best focus of the points; or say why not."""
    if len(points) < _FEWEST_POINTS:
        return None, f"{len(points)} edges have a best focus, where {_FEWEST_POINTS} are needed"
    design = np.array([_terms(one, picture) for one in points])
    scaled = design / np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-12)
    if np.linalg.cond(scaled) > _CONDITION_MOST:
        return None, (
            "the edges do not lie all over the picture in both directions, along the radius and "
            "across it"
        )
    best = np.array([one.best_mm.value for one in points])
    errs = np.array([one.best_mm.err for one in points])
    fit, scatter = _field_fit(design, best, errs)
    for _ in range(_FIELD_STEPS if growth_per_mm else 0):
        astigmatism = fit.coefficients[3] - fit.coefficients[4]
        before = 2 * growth_per_mm * astigmatism**2 * design[:, 3] * design[:, 4]
        fit, scatter = _field_fit(design, best + before, errs)

    def value(*shares: float) -> MeasuredValue:
        by = np.array(shares)
        err = sqrt(float(by @ fit.covariance @ by))
        return MeasuredValue(value=float(by @ fit.coefficients), err=err)

    slope_x, slope_y = fit.coefficients[1:3].tolist()
    steep = max(hypot(slope_x, slope_y), 1e-12)
    found = FocusField(
        tilt_x_mm=value(0, 1, 0, 0, 0),
        tilt_y_mm=value(0, 0, 1, 0, 0),
        tilt_mm=value(0, slope_x / steep, slope_y / steep, 0, 0),
        tilt_deg=_turn(fit, picture) if axis == "focus" else None,
        tangential_mm=value(0, 0, 0, 1, 0),
        sagittal_mm=value(0, 0, 0, 0, 1),
        curvature_mm=value(0, 0, 0, 0.5, 0.5),
        astigmatism_mm=value(0, 0, 0, 1, -1),
        scatter_mm=scatter,
    )
    return _Found(value(1, 0, 0, 0, 0), found), None


def _field_fit(design: FloatArray, best: FloatArray, errs: FloatArray) -> tuple[_Fit, float]:
    """The field, and what the points scatter by about it beyond their errors."""
    scatter = _scatter(design, best, errs)
    weights = 1 / np.hypot(errs, scatter)
    return _least_squares(weights[:, None] * design, weights * best), scatter


def _growth_per_mm(tracks: Sequence[_Track], picture: Picture) -> float:
    """By what share the picture grows a mm of position: edges far from its centre tell."""
    middle = np.array([((picture.width_px or 1) - 1) / 2, ((picture.height_px or 1) - 1) / 2])
    slopes, radii = [], []
    for track in tracks:
        if len(track.edges) < _FEWEST_POSITIONS:
            continue
        away = np.array([(one.x_px, one.y_px) for one in track.edges]) - middle
        radius = np.hypot(*away.T)
        slopes.append(float(np.polyfit(track.positions_mm, radius, 1)[0]) / float(radius.mean()))
        radii.append(float(radius.mean()))
    far = np.array(radii) >= np.median(radii) if radii else np.zeros(0, np.bool_)
    return float(np.median(np.array(slopes)[far])) if far.any() else 0.0


def _terms(point: FocusPoint, picture: Picture) -> tuple[float, ...]:
    """What the best focus of a point is made of: 1, x, y, and r^2 along and across the radius."""
    width, height = picture.width_px or 1, picture.height_px or 1
    right, down = point.x_px - (width - 1) / 2, point.y_px - (height - 1) / 2
    normal = radians(point.angle_deg) + pi / 2
    # r^2 cos^2 a and r^2 sin^2 a are squares across and along the edge, the latter over its length.
    across = (right * cos(normal) + down * sin(normal)) ** 2
    along = (down * cos(normal) - right * sin(normal)) ** 2 + point.length_px**2 / 12
    corner = 0.25 * (width**2 + height**2)
    return 1.0, right / width, down / height, across / corner, along / corner


def _scatter(design: FloatArray, best: FloatArray, errs: FloatArray) -> float:
    """Scatter beyond the errors, with which the points agree with the field (Paule and Mandel)."""
    free = best.size - design.shape[1]

    def excess(scatter: float) -> float:
        weights = 1 / np.hypot(errs, scatter)
        return float(_least_squares(weights[:, None] * design, weights * best).chi2 - free)

    low, high = 0.0, float(np.ptp(best)) + float(errs.max())
    if excess(low) <= 0:
        return 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return 0.5 * (low + high)


def _turn(fit: _Fit, picture: Picture) -> MeasuredValue | None:
    """Turn of the sensor, from the slopes over its width and height in mm."""
    if picture.pixel_pitch_um is None or picture.width_px is None or picture.height_px is None:
        return None
    sides = np.array([picture.width_px, picture.height_px]) * picture.pixel_pitch_um / 1000
    slopes = fit.coefficients[1:3] / sides
    steep = float(np.hypot(*slopes))
    along = slopes / max(steep, 1e-12) / sides
    err = sqrt(float(along @ fit.covariance[1:3, 1:3] @ along))
    return MeasuredValue(value=degrees(atan(steep)), err=degrees(err / (1 + steep**2)))


def _median_depth(points: Sequence[FocusPoint], contrast: float) -> MeasuredValue | None:
    """Median of the depths; what the e-SFR may be off by does not average out."""
    known = [(one, one.depth_mm) for one in points if one.depth_mm is not None]
    if not known:
        return None
    depths, errs = np.array([(depth.value, depth.err) for _, depth in known]).T
    off = np.median([_off_by_esfr(one, depth.value, contrast) for one, depth in known])
    err = hypot(_median_err(depths, errs), float(off))
    return MeasuredValue(value=float(np.median(depths)), err=err)


def _off_by_esfr(point: FocusPoint, depth_mm: float, contrast: float) -> float:
    """What a depth is off by if all contrasts are: of a parabola of the logarithm."""
    return _OF_ESFR * depth_mm / (2 * log(point.contrast.value / contrast))


def _median_err(values: FloatArray, errs: FloatArray) -> float:
    return float(median_err(values[:, None], errs[:, None])[0])


def _common_depth(points: Sequence[FocusPoint], contrast: float) -> MeasuredValue | None:
    """From the last near end to the first far end; None if one lies beyond the positions."""
    near = [one.nearest_mm for one in points if one.nearest_mm is not None]
    far = [one.farthest_mm for one in points if one.farthest_mm is not None]
    if len(near) < len(points) or len(far) < len(points):
        return None
    last, first = max(near, key=lambda one: one.value), min(far, key=lambda one: one.value)
    off = float(np.median([_off_by_esfr(one, one.depth_mm.value, contrast) for one in points
                           if one.depth_mm is not None]))  # fmt: skip
    err = hypot(first.err, last.err, off)
    return MeasuredValue(value=first.value - last.value, err=err)
