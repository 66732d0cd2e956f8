"""What edges of one capture share: its focus, and the softness of the target at its scale.

Squared widths of edges whose capture adds a variance of its own to all of them alike. ``sigma_i^2 =
(design row i) values + u_c + e_i``: the focus of capture c moves all its edges by the same variance
``u_c``, with a standard deviation between captures that is estimated, and edge i has an error of
its own. Thirty edges of five captures are then not thirty independent widths.

Whether captures scatter at all is tested first. Where they do not, the edges are independent and
nothing here applies; where they do, the errors hold the scatter and the intervals are Student's,
with Satterthwaite's degrees of freedom: the scatter of a few captures is itself uncertain.

References
----------
S. R. Searle, G. Casella and C. E. McCulloch, "Variance Components", Wiley 1992, chapters 6 and 7;
F. G. Giesbrecht and J. C. Burns, "Two-stage analysis based on a mixed model", Biometrics 41 (1985)
477-486, for the degrees of freedom.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from math import inf, sqrt
from typing import Literal

import numpy as np
from scipy.special import chdtrc, fdtrc, stdtrit

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement
from simulation.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedByCapture:
    """What is known of the edges' captures.

    ``group`` is the number of each edge's capture, ``normal_rad`` the direction of its normal.
    ``columns``, shape ``(edges, k)``, are what unknowns that the captures share do to the squared
    widths, beside their focus; ``precision`` is the inverse variance with which each of them is
    known beforehand, 0 for not.
    """

    group: IntArray
    normal_rad: FloatArray
    columns: FloatArray
    precision: FloatArray

    @classmethod
    def of(
        cls,
        edges: Sequence[EdgeMeasurement],
        columns: FloatArray | None = None,
        precision: FloatArray | None = None,
    ) -> "SharedByCapture":
        """Return the captures of these edges, which share nothing but their focus if not told."""
        return cls(
            group=capture_numbers(edges),
            normal_rad=np.array([edge.normal_rad for edge in edges]),
            columns=np.empty((len(edges), 0)) if columns is None else columns,
            precision=np.empty(0) if precision is None else precision,
        )

    def some(self, chosen: IntArray) -> "SharedByCapture":
        """Return those of some edges."""
        return SharedByCapture(
            group=self.group[chosen],
            normal_rad=self.normal_rad[chosen],
            columns=self.columns[chosen],
            precision=self.precision,
        )

    @property
    def is_single(self) -> bool:
        """Whether each capture has one edge, so that edges are independent as they are."""
        return self.captures == self.group.size

    @property
    def fourfold(self) -> FloatArray:
        """What widths may change by direction beyond an ellipse: cos 4a and sin 4a."""
        return np.column_stack([np.cos(4 * self.normal_rad), np.sin(4 * self.normal_rad)])

    @property
    def captures(self) -> int:
        """Number of captures."""
        return int(np.unique(self.group).size)


_LEAST_SHARE = 0.01  # of its variance; nothing that is taken off an edge leaves it less
LEAST_ERR_PX = 1e-9  # noise-free edges have no error, but need a finite weight


def capture_of(edge: EdgeMeasurement) -> Hashable:
    """What tells the capture of an edge from others: its number, or the name of its image."""
    return edge.image if edge.capture is None else edge.capture


def by_capture(edges: Sequence[EdgeMeasurement]) -> dict[Hashable, list[EdgeMeasurement]]:
    """Group edges by their captures, in the order of their first appearance."""
    captures: dict[Hashable, list[EdgeMeasurement]] = {}
    for edge in edges:
        captures.setdefault(capture_of(edge), []).append(edge)
    return captures


def capture_numbers(edges: Sequence[EdgeMeasurement]) -> IntArray:
    """Number the captures of edges, from 0 in the order of their first appearance."""
    numbers = {key: number for number, key in enumerate(by_capture(edges))}
    return np.array([numbers[capture_of(edge)] for edge in edges], dtype=np.int64)


def widths_of(edges: Sequence[EdgeMeasurement]) -> tuple[FloatArray, FloatArray]:
    """Return the total widths of edges, and their errors, none of which is 0."""
    sigma = np.array([edge.sigma_px for edge in edges])
    return sigma, np.maximum([edge.sigma_err_px for edge in edges], LEAST_ERR_PX)


def without_blur(edge: EdgeMeasurement, blur_px2: float) -> EdgeMeasurement:
    """Return the edge with less variance, of total and optical width; a hundredth is left."""
    if blur_px2 == 0:
        return edge
    sigma_px, err_px = _narrowed(edge.sigma_px, edge.sigma_err_px, blur_px2)
    optical_px, optical_err_px = edge.optical_sigma_px, edge.optical_sigma_err_px
    if optical_px is not None and optical_err_px is not None:
        if optical_px**2 <= blur_px2:
            optical_px, optical_err_px = None, None
        else:
            optical_px, optical_err_px = _narrowed(optical_px, optical_err_px, blur_px2)
    return edge.model_copy(
        update={
            "sigma_px": sigma_px,
            "sigma_err_px": err_px,
            "optical_sigma_px": optical_px,
            "optical_sigma_err_px": optical_err_px,
        }
    )


def _narrowed(sigma_px: float, err_px: float, blur_px2: float) -> tuple[float, float]:
    """A width and its error: that of the variance stays what it is."""
    narrow_px = sqrt(max(sigma_px**2 - blur_px2, _LEAST_SHARE * sigma_px**2))
    return narrow_px, err_px * sigma_px / narrow_px


def excess_variance(
    deviation: FloatArray, err: FloatArray, trust: FloatArray, freedom: float
) -> float:
    """Excess variance, beyond the errors, that brings the weighted squares to their expected value.

    Paule and Mandel, "Consensus values and weighting factors", J. Res. NBS 87 (1982) 377.
    """
    squares = trust * deviation**2
    variance = 0.0
    while True:
        weight = 1.0 / (err**2 + variance)
        surplus = float(np.sum(squares * weight)) - freedom
        if surplus <= 0:
            return variance
        # Newton's steps on a convex curve that falls: all of them are upwards, but for rounding.
        step = surplus / float(np.sum(squares * weight**2))
        variance += step
        if step <= 1e-12 * variance:
            return variance


SCATTERS_P = 0.05
"""Significance from which captures count as different: below, the edges are independent.

Without scatter, one calibration in twenty then has intervals wider than it needs."""

_FEWEST_BETWEEN = 2
"""Degrees of freedom between captures; with one, Student's quantile is 12.7."""

_ROUNDS = 4
_TUKEY_SIGMAS = 5.0
_LEAST_TRUST = 1e-3
_RANK_TOLERANCE = 1e-7
_TELLS = 0.05  # least singular value, of columns of order 1, over the root of the number of edges


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeSquares:
    """Squared widths with their model: ``spread_px`` turns an error of a width into one of them."""

    design: FloatArray
    squares_px2: FloatArray
    err_px: FloatArray
    spread_px: FloatArray
    trust: FloatArray

    def weight(self, scatter2: float) -> FloatArray:
        """Inverse variances of the squared widths."""
        return np.asarray(self.trust / (self.spread_px**2 * (self.err_px**2 + scatter2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureFit:
    """Elements of a covariance from edges that share their capture's focus.

    ``values`` are without the captures' further unknowns, ``shared_values``; ``by_focus`` is the
    derivative of ``covariance`` by the variance between captures, ``scatter2_px4``, which is a part
    of it only if ``holds_scatter``. ``p_value`` is of so much difference between captures that have
    none, whatever the widths do with direction. ``offset_px2`` is what the focus of each capture
    adds to its squared widths, 0 where captures do not differ significantly. ``scatter_px`` and
    ``trust`` are the scatter within captures beyond their errors, and the edges' robust weights;
    ``between`` are degrees of freedom. ``shared_err_px2`` is what scatter and further unknowns
    leave in the variance averaged over both axes. ``is_single``: each capture has one edge, so that
    what differs may be the edges.
    """

    values: FloatArray
    covariance: FloatArray
    shared_values: FloatArray
    by_focus: FloatArray
    scatter2_px4: float
    scatter2_err_px4: float
    p_value: float
    offset_px2: dict[int, float] = field(repr=False)
    scatter_px: float
    trust: FloatArray = field(repr=False)
    captures: int
    between: int
    shared_err_px2: float
    is_single: bool
    holds_scatter: bool

    @property
    def is_scattered(self) -> bool:
        """Whether captures, and not their edges alone, differ significantly."""
        return self.holds_scatter and not self.is_single

    def freedom(self, slope: FloatArray) -> float:
        """Satterthwaite's degrees of freedom of what changes by ``slope`` with each value."""
        part = float(slope @ self.by_focus @ slope)
        if not self.holds_scatter or part <= 0:
            return inf
        whole = float(slope @ self.covariance @ slope)
        return max(2 * (whole / (part * self.scatter2_err_px4)) ** 2, 1.0)

    def reach(self, slope: FloatArray) -> float:
        """Half of the 95 % interval over the standard error of what changes by ``slope``."""
        return float(stdtrit(self.freedom(slope), 0.975))


def shared_reach_px2(fit: CaptureFit | None) -> float:
    """Return the error of the variance that captures share, with Student's quantile in it."""
    if fit is None:
        return 0.0
    freedom = float(fit.between) if fit.holds_scatter else inf
    return fit.shared_err_px2 * float(stdtrit(freedom, 0.975) / stdtrit(inf, 0.975))


def fit_by_capture(edges: EdgeSquares, shared: SharedByCapture) -> CaptureFit | None:
    """Fit elements of a covariance, with the scatter of the focus between captures.

    Their linear model has full rank. None where captures are too few to tell: there is one, or all
    that but one of their differences say is the model's, as where each has another direction.
    """
    count = edges.design.shape[1]
    known = np.concatenate([np.zeros(count), shared.precision])
    whole = EdgeSquares(
        design=np.column_stack([edges.design, shared.columns]),
        squares_px2=edges.squares_px2,
        err_px=edges.err_px,
        spread_px=edges.spread_px,
        trust=np.maximum(edges.trust, _LEAST_TRUST),
    )
    numbers, group = np.unique(shared.group, return_inverse=True)
    model = _CaptureModel(whole, group.astype(np.int64), known)
    if model.between < _FEWEST_BETWEEN:
        return None
    strict = model.with_columns(shared.fourfold)
    p_value = max(model.p_value, strict.p_value)
    model.is_scattered = (model.p_value if shared.is_single else p_value) < SCATTERS_P
    for _ in range(_ROUNDS):
        if not model.is_scattered:
            break
        model = model.with_trust(edges.trust)
    fitted = model.solved()
    own = slice(0, count)
    return CaptureFit(
        values=fitted.values[own],
        covariance=fitted.covariance[own, own],
        shared_values=fitted.values[count : count + len(shared.precision)],
        by_focus=fitted.by_focus[own, own],
        scatter2_px4=(
            model if model.is_scattered and not shared.is_single else strict
        ).scatter2_px4,
        scatter2_err_px4=fitted.scatter2_err_px4,
        p_value=p_value,
        offset_px2=(
            {}
            if shared.is_single
            else dict(zip(numbers.tolist(), fitted.offset_px2.tolist(), strict=True))
        ),
        scatter_px=sqrt(model.scatter2_px2),
        trust=model.edges.trust,
        captures=shared.captures,
        between=model.between,
        shared_err_px2=(
            _shared_err(edges, model, fitted)
            if model.is_scattered or shared.precision.size
            else 0.0
        ),
        is_single=shared.is_single,
        holds_scatter=model.is_scattered,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solved:
    values: FloatArray
    covariance: FloatArray
    by_focus: FloatArray
    offset_px2: FloatArray
    scatter2_err_px4: float


def _shared_err(edges: EdgeSquares, model: "_CaptureModel", fitted: _Solved) -> float:
    """What captures add to the error of the variance that both axes share."""
    count = edges.design.shape[1]
    isotropic = np.linalg.lstsq(edges.design, np.ones(len(edges.design)), rcond=None)[0]
    # Of xx, xy and yy it is the mean of xx and yy; of a single width, that one.
    slope = isotropic / float(isotropic @ isotropic)
    weight = model.weight
    alone = np.linalg.inv(edges.design.T @ (weight[:, None] * edges.design))
    whole = fitted.covariance[:count, :count]
    return sqrt(max(float(slope @ (whole - alone) @ slope), 0.0))


def _hardly_told(within: FloatArray) -> tuple[FloatArray, int]:
    """Directions of a design that its rows hardly tell, as columns of norm 1, and its rank."""
    rows = within.shape[0]
    left, strengths, _ = np.linalg.svd(within, full_matrices=False)
    told = strengths > _RANK_TOLERANCE * rows
    return np.asarray(left[:, told & (strengths < _TELLS * sqrt(rows))]), int(told.sum())


class _CaptureModel:
    """Weighted least squares with a variance that edges of one capture share.

    The inverse of ``W^-1 + tau^2 Z Z'`` is W less a matrix of rank one for each capture (Sherman
    and Morrison), so that sums over captures are all that is needed.
    """

    def __init__(self, edges: EdgeSquares, group: IntArray, known: FloatArray) -> None:
        self.group, self.captures = group, int(group.max()) + 1
        self._given = edges, known
        # What edges of one capture hardly tell apart, as where they are parallel to a degree, is an
        # unknown of its own: else its large error stands for a difference between captures.
        within = self._less_mean(edges.design, np.ones(group.size))
        hardly, rank = _hardly_told(within)
        edges = replace(edges, design=np.column_stack([edges.design, hardly]))
        self.edges, self.known = edges, np.concatenate([known, np.zeros(hardly.shape[1])])
        free = int(np.count_nonzero(self.known == 0))
        self.between = self.captures + rank - free
        self.freedom = float(edges.trust.sum()) - self.captures - rank
        self.scatter2_px2 = self._edge_scatter()
        self.weight = edges.weight(self.scatter2_px2)
        self._sums = np.bincount(group, self.weight, self.captures)
        self.is_scattered = False
        self._test()

    def _less_mean(self, columns: FloatArray, weight: FloatArray) -> FloatArray:
        """Columns less their means over captures."""
        total = np.bincount(self.group, weight, self.captures)
        sums = self._summed(weight[:, None] * columns)
        return np.asarray(columns - (sums / total[:, None])[self.group])

    def _summed(self, columns: FloatArray) -> FloatArray:
        """Sums over captures, shape ``(captures, columns)``."""
        out = np.zeros((self.captures, columns.shape[1]))
        np.add.at(out, self.group, columns)
        return out

    def _left_within(self, weight: FloatArray) -> FloatArray:
        """What the model leaves of squared widths, each capture's own level fitted."""
        root = np.sqrt(weight)
        design = self._less_mean(self.edges.design, weight)
        squares = self._less_mean(self.edges.squares_px2[:, None], weight)[:, 0]
        values = np.linalg.lstsq(root[:, None] * design, root * squares, rcond=_RANK_TOLERANCE)[0]
        return np.asarray(squares - design @ values)

    def _edge_scatter(self) -> float:
        """Variance of widths within captures beyond their errors, in px^2."""
        if self.freedom < 1:
            return 0.0
        scatter2 = 0.0
        for _ in range(3):
            left = self._left_within(self.edges.weight(scatter2)) / self.edges.spread_px
            scatter2 = excess_variance(left, self.edges.err_px, self.edges.trust, self.freedom)
        return scatter2

    def _test(self) -> None:
        """Test whether captures differ, and estimate by how much."""
        self._within_squares = float(np.sum(self.weight * self._left_within(self.weight) ** 2))
        surplus = self._between_squares(0.0)
        if self.between < 1:
            self.p_value, self.scatter2_px4 = 1.0, 0.0
            return
        if self.scatter2_px2 > 0:
            self.p_value = float(fdtrc(self.between, self.freedom, surplus / self.between))
        else:
            self.p_value = float(chdtrc(self.between, surplus))
        self.scatter2_px4 = self._between_variance(surplus)

    def _between_variance(self, surplus: float) -> float:
        if surplus <= self.between:
            return 0.0
        from scipy.optimize import brentq  # .1 s, where captures differ

        most = surplus / self.between * self.captures / float(self._sums.mean())
        while self._between_squares(most) > self.between:
            most *= 4
        return float(
            brentq(lambda t: self._between_squares(t) - self.between, 0.0, most, rtol=1e-10)
        )

    def with_columns(self, columns: FloatArray) -> "_CaptureModel":
        """Return the model with more columns, as far as the edges and captures tell them."""
        edges, known = self._given
        wider = np.column_stack([self.edges.design, columns])
        tolerance = _TELLS * wider.shape[0] ** 0.5
        if np.linalg.matrix_rank(wider, tol=tolerance) < wider.shape[1]:
            return self
        design = np.column_stack([edges.design, columns])
        known = np.concatenate([known, np.zeros(columns.shape[1])])
        more = _CaptureModel(replace(edges, design=design), self.group, known)
        return more if more.between > 0 else self

    def _between_squares(self, scatter2_px4: float) -> float:
        """Weighted squares between captures, over what focus of that scatter explains."""
        normal, right, squares = self._normal(scatter2_px4)
        values = np.linalg.solve(normal, right)
        return float(squares - right @ values) - self._within_squares

    def _shrunk(self, scatter2_px4: float) -> FloatArray:
        return np.asarray(scatter2_px4 / (1 + scatter2_px4 * self._sums))

    def _normal(self, scatter2_px4: float) -> tuple[FloatArray, FloatArray, float]:
        """X'V^-1 X with what is known beforehand, X'V^-1 y and y'V^-1 y."""
        design, squares = self.edges.design, self.edges.squares_px2
        weighted = self.weight[:, None] * design
        sums = self._summed(weighted)
        level = np.bincount(self.group, self.weight * squares, self.captures)
        shrunk = self._shrunk(scatter2_px4)
        normal = design.T @ weighted - sums.T @ (shrunk[:, None] * sums) + np.diag(self.known)
        right = weighted.T @ squares - sums.T @ (shrunk * level)
        total = float(np.sum(self.weight * squares**2) - np.sum(shrunk * level**2))
        return np.asarray(normal), np.asarray(right), total

    def solved(self) -> _Solved:
        """Values with their covariance, which holds the scatter where that is significant."""
        scatter2 = self.scatter2_px4 if self.is_scattered else 0.0
        normal, right, _ = self._normal(scatter2)
        covariance = np.linalg.inv(normal)
        values = covariance @ right
        sums = self._summed(self.weight[:, None] * self.edges.design)
        # X'V^-1 Z, and Z'V^-1 Z, which is diagonal
        shared = sums.T / (1 + scatter2 * self._sums)
        gain = covariance @ shared
        power = float(np.sum(self._sums / (1 + scatter2 * self._sums)) - np.sum(shared * gain))
        left = self.edges.squares_px2 - self.edges.design @ values
        level = np.bincount(self.group, self.weight * left, self.captures)
        return _Solved(
            values=values,
            covariance=np.asarray(covariance, dtype=np.float64),
            by_focus=gain @ gain.T,
            offset_px2=np.asarray(self._shrunk(scatter2) * level),
            scatter2_err_px4=sqrt(2 * max(self.between, 0)) / power if power > 0 else inf,
        )

    def with_trust(self, first: FloatArray) -> "_CaptureModel":
        """Return the model with edges weighed by how well they agree with their own capture."""
        solved = self.solved()
        left = self.edges.squares_px2 - self.edges.design @ solved.values
        left = left - solved.offset_px2[self.group]
        spread = self.edges.spread_px * np.sqrt(self.edges.err_px**2 + self.scatter2_px2)
        ratio = np.abs(left / spread) / _TUKEY_SIGMAS
        trust = np.where(ratio < 0.5, 1.0, np.where(ratio < 1, (1 - ratio**2) ** 2, 0.0))
        # An edge that the others contradict whatever its capture does not come back in.
        trust = np.where(first > 0, np.maximum(trust, _LEAST_TRUST), _LEAST_TRUST)
        edges, known = self._given
        again = _CaptureModel(replace(edges, trust=trust), self.group, known)
        again.is_scattered = self.is_scattered and again.scatter2_px4 > 0
        return again


class FocusScatter(StoredModel):
    """How much the variance of the PSF, averaged over both axes, scatters between captures.

    ``scatter_px2`` is beyond what the edges' errors and their scatter within captures explain;
    ``mean_err_px2`` is what it leaves in the mean variance of this calibration, 0 where captures do
    not differ significantly. ``freedom`` are Student's degrees of freedom between captures,
    ``p_value`` is of so much difference if their focus were the same.
    """

    scatter_px2: float
    scatter_err_px2: float
    mean_err_px2: float
    captures: int
    freedom: float | None = None
    p_value: float | None = None
    source: Literal["captures"] = "captures"

    @classmethod
    def of(cls, fit: CaptureFit) -> "FocusScatter":
        """Return the scatter between the captures of a calibration."""
        scatter = sqrt(fit.scatter2_px4)
        return cls(
            scatter_px2=scatter,
            scatter_err_px2=scatter_err(fit.scatter2_px4, fit.scatter2_err_px4),
            mean_err_px2=_mean_err(fit, scatter),
            captures=fit.captures,
            freedom=float(fit.between),
            p_value=fit.p_value,
        )


def scatter_err(scatter2: float, scatter2_err: float) -> float:
    """Return the standard error of a scatter from that of its square.

    Near zero the square is what has a normal error, and the root is as unsure as the root of that.
    """
    scatter = sqrt(scatter2)
    if scatter2_err > scatter2:
        return sqrt(scatter2 + scatter2_err) - scatter
    return scatter2_err / (2 * scatter)


def _mean_err(fit: CaptureFit, scatter_px2: float) -> float:
    if fit.is_single and fit.p_value < SCATTERS_P:
        return scatter_px2 / sqrt(fit.captures)
    return fit.shared_err_px2 if fit.is_scattered else 0.0
