"""The two-dimensional transfer function: the choice of its form, and what psf.json stores of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import log
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from acquisition.files import StoredModel
from calibration.edges import BinnedEdge, orientation_of
from calibration.psf._covariance import USUAL_RHO
from calibration.psf._otf_fit import (
    FULL_STEPS,
    MOST_GROUPS,
    CorrectionEvidence,
    OtfFit,
    correction_evidence,
    dispersion,
    expected_gain,
    fit_correction,
    fit_form,
    pooled,
    settled,
)
from calibration.psf._otf_forms import (
    ASTIGMATIC,
    AXIAL,
    AXIAL_GAUSSIAN,
    AXIAL_TOTAL_GAUSSIAN,
    ELLIPTIC,
    GAUSSIAN,
    ROUND,
    TOTAL_GAUSSIAN,
    TWO_ELLIPSES,
    EdgeStack,
    FormName,
    OtfForm,
    StackedBins,
    form_of,
)
from simulation.arrays import FloatArray
from simulation.psf import (
    CORRECTION_HARMONICS,
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    correction_harmonics,
    correction_splines,
)

_SAME_DIRECTION_DEG = 8.0
_WIDEST_GAP_DEG = 100.0  # vertical, horizontal and one diagonal edge between them tell an ellipse
_FEWEST_FOR_CORRECTION = 6  # directions; cos 2a and sin 2a need more than twice 2
_FEWEST_FOR_FOURFOLD = 8
# Of a criterion, and of twice the logarithm of a likelihood ratio: "very strong" and "strong"
# evidence (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995).
_MUCH_BETTER, _BETTER = 10.0, 6.0
_NOT_WORTH_A_FIT = 8.0  # expected of chi-squared: two parameters must gain 26 to be taken
_FEW_STEPS = 2
# JPEG photographs of chessboards stand at 1200: their edges differ by far more than their noise;
# what they share of a shape cannot be told from that.
_TOO_SCATTERED = 10.0
_SCATTERED = 1.5  # below, the correction stays as it is for the noise alone
_LEAST_VARIANCE_PX2 = 2.5e-3
_START_EDGES, _START_STEPS = 6, 3
_VALLEYS, _MORE_STEPS = 2, 5  # the best two of the starts go on
# Starts: cut-off period and Gaussian width over the optical width of the edges, squared defocus.
_START_PERIODS = (0.25, 0.5, 1.0, 2.0, 3.5)
_START_WIDTHS = (0.0, 0.7)
_START_DEFOCUS_WAVES2 = (0.0, 0.25, 1.0, 6.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _OtfChoice:
    """The form chosen and why; ``scale`` multiplies the inverse to give the covariance.

    Without ``knows_turn`` the edges leave open how the lens is turned: all forms are upright.
    """

    fit: OtfFit
    reason: str
    scale: float
    chi2_reduced: float
    knows_turn: bool


def _choose_otf(
    edges: Sequence[BinnedEdge], *, knows_correlation: bool = True
) -> _OtfChoice | None:
    """Fit the forms that the directions of the edges allow, and take the one they ask for.

    Forms without a correction are compared by the Bayesian information criterion (Schwarz,
    "Estimating the dimension of a model", Ann. Stat. 6, 1978), smooth corrections, whose parameters
    are not of equal weight, by Akaike's. Chi-squared counts over the scatter of the edges
    themselves: pixels' noise alone would call every change from edge to edge a new shape of lens.
    Where the widths leave rho undetermined only upright lenses are fitted, whose ellipses lie along
    the axes: directions close to each other would decide how one is turned, and between them a lens
    changes over its field as well. None where the edges are none, or all of one direction, or two
    directions that are not those of vertical and horizontal edges.
    """
    directions = _distinct_directions_deg([edge.normal_rad for edge in edges])
    if directions.size < 2:
        return None
    has_third = directions.size > 2 and _widest_gap_deg(directions) <= _WIDEST_GAP_DEG
    is_spread = has_third and knows_correlation
    named = {orientation_of(angle + 90.0) for angle in directions.tolist()}
    if not is_spread and not {"vertical", "horizontal"} <= named:
        return None
    every = EdgeStack(StackedBins.of(edges))
    stack, plain = _uncorrected_fits(every, _optical_variance(edges), is_spread=is_spread)
    if not plain:
        return None
    told_by = "widths that leave rho open" if has_third else f"{directions.size} directions"
    limits = "" if is_spread else f"; {told_by} do not show its orientation: taken as upright"
    bases = [fit for fit in plain if fit.form in (ELLIPTIC, ASTIGMATIC, TWO_ELLIPSES)]
    asked: list[CorrectionEvidence] = []
    base = min(bases, key=_cost, default=plain[0])
    if bases and directions.size >= _FEWEST_FOR_CORRECTION:
        harmonics = (1, 3) if directions.size < _FEWEST_FOR_FOURFOLD else (1, 3, 5)
        asked = correction_evidence(stack, base, harmonics)
    correction = _Correction(stack=stack, base=base, asked=asked)
    choice = _best(every, plain, correction)
    return replace(choice, reason=choice.reason + limits, knows_turn=is_spread)


def _distinct_directions_deg(normal_rad: Sequence[float]) -> FloatArray:
    """Directions in [0, 180) that are further apart than a few degrees, in order."""
    distinct: list[float] = []
    for angle in np.sort(np.rad2deg(normal_rad) % 180.0).tolist():
        # Both neighbours on the circle: the last kept one, and the first.
        others = distinct[:1] + distinct[-1:]
        if all(_apart(angle, other) > _SAME_DIRECTION_DEG for other in others):
            distinct.append(angle)
    return np.array(distinct)


def _widest_gap_deg(directions_deg: FloatArray) -> float:
    """Largest angle between neighbouring directions."""
    return float(np.max(np.diff(np.append(directions_deg, directions_deg[0] + 180.0))))


def _apart(first_deg: float, second_deg: float) -> float:
    return abs((first_deg - second_deg + 90.0) % 180.0 - 90.0)


def _optical_variance(edges: Sequence[BinnedEdge]) -> float:
    total = float(np.median([edge.sigma_px**2 - edge.blur_px2 for edge in edges]))
    return max(total - 1 / 12, _LEAST_VARIANCE_PX2)


def _round_start(bins: StackedBins, variance_px2: float) -> FloatArray:
    """Parameters of a round lens from a grid; the best of each defocus race on a few edges.

    Chi-squared has valleys with and without defocus.
    """
    pace = max(len(bins.levels) // _START_EDGES, 1)
    stack = EdgeStack(bins.some(slice(None, pace * _START_EDGES, pace)))
    width = variance_px2**0.5
    found = []
    for waves2 in _START_DEFOCUS_WAVES2:
        starts = [
            np.array([period * width, waves2, (share * width) ** 2])
            for period, share in product(_START_PERIODS, _START_WIDTHS)
        ]
        slices = [ROUND.slices(start, stack.normal_rad) for start in starts]
        squares = [stack.residuals(one, with_slopes=False).squares for one in slices]
        found.append(fit_form(stack, ROUND, starts[int(np.argmin(squares))], _START_STEPS))
    ahead = sorted((fit for fit in found if fit is not None), key=lambda fit: fit.squares)
    more = [fit_form(stack, ROUND, fit.parameters, _MORE_STEPS) for fit in ahead[:_VALLEYS]]
    best = min((fit for fit in more if fit), key=lambda fit: fit.squares, default=None)
    return np.array([width, 0.0, variance_px2]) if best is None else best.parameters


def _uncorrected_fits(
    every: EdgeStack, variance_px2: float, *, is_spread: bool
) -> tuple[EdgeStack, list[OtfFit]]:
    """Fits of the forms without a correction, simplest first, and the edges that they are of.

    Those are the edges themselves; many edges are pooled by their direction, about a Gaussian at
    first and then about the best of the first fits. Whatever these show of the places of the edges
    is put right before the last ones.
    """
    is_many = len(every.normal_rad) > MOST_GROUPS
    stack = every
    if is_many:
        guess = np.full(2, variance_px2)
        left = every.left_by(AXIAL_GAUSSIAN.slices(guess, every.normal_rad))
        stack = pooled(every, AXIAL_GAUSSIAN, guess, left)
    start = _round_start(stack.binned, variance_px2)
    fits = _first_fits(stack, variance_px2, start, is_spread=is_spread)
    if not fits:
        return stack, []
    best = min(fits, key=_cost)
    left = best.residuals
    if is_many:
        left = every.left_by(best.form.slices(best.parameters, every.normal_rad))
    is_moved = every.aligned(left.shift_px)
    if is_many:
        stack = pooled(every, best.form, best.parameters, left)
    if is_moved or is_many:
        again = [fit_form(stack, fit.form, fit.parameters) for fit in fits]
        fits = [fit for fit in again if fit is not None]
    both = _two_ellipses(stack, fits)
    return stack, fits if both is None else [*fits, both]


def _first_fits(
    stack: EdgeStack, variance_px2: float, round_start: FloatArray, *, is_spread: bool
) -> list[OtfFit]:
    """Fits of the simpler forms that the directions allow."""
    lens, total = (
        (GAUSSIAN, TOTAL_GAUSSIAN) if is_spread else (AXIAL_GAUSSIAN, AXIAL_TOTAL_GAUSSIAN)
    )
    start = variance_px2 * np.array([1.0, 0.0, 1.0] if is_spread else [1.0, 1.0])
    pixel = np.array([1.0, 0.0, 1.0] if is_spread else [1.0, 1.0]) / 12
    round_lens = fit_form(stack, ROUND, round_start)
    fits = [fit_form(stack, lens, start), fit_form(stack, total, start + pixel), round_lens]
    if round_lens is not None:
        richer = (ELLIPTIC, ASTIGMATIC) if is_spread else AXIAL
        fits += [_gone_on(stack, form, round_lens) for form in richer]
    return [fit for fit in fits if fit is not None]


def _gone_on(stack: EdgeStack, form: OtfForm, simpler: OtfFit) -> OtfFit | None:
    """A fit of a richer form from the lens of a simpler one; a few steps where it gains little."""
    start = form.nearest(simpler.form.elements @ simpler.parameters)
    is_worth = expected_gain(stack, form, simpler, start) > _NOT_WORTH_A_FIT
    return fit_form(stack, form, start, FULL_STEPS if is_worth else _FEW_STEPS)


def _two_ellipses(stack: EdgeStack, fits: Sequence[OtfFit]) -> OtfFit | None:
    """An elliptic pupil with an elliptic Gaussian: either may be the one that is not round.

    None where they gain nothing, or an elliptic pupil is no better than a total Gaussian.
    """
    known = {fit.form: fit for fit in fits}
    elliptic, total = known.get(ELLIPTIC), known.get(TOTAL_GAUSSIAN)
    if elliptic is None or (total is not None and elliptic.squares >= total.squares):
        return None
    start = np.append(elliptic.parameters, [0.0, elliptic.parameters[-1]])
    if expected_gain(stack, TWO_ELLIPSES, elliptic, start) <= _NOT_WORTH_A_FIT:
        return None
    starts = [start]
    if GAUSSIAN in known and ROUND in known:
        period, defocus, spread = known[ROUND].parameters.tolist()
        xx, xy, yy = known[GAUSSIAN].parameters.tolist()
        even = spread - 0.5 * (xx + yy)
        starts.append(np.array([period, 0.0, period, defocus, xx + even, xy, yy + even]))
    both = [fit_form(stack, TWO_ELLIPSES, start) for start in starts]
    return min((fit for fit in both if fit), key=lambda fit: fit.squares, default=None)


def _cost(fit: OtfFit) -> float:
    """Akaike's criterion."""
    return fit.squares + 2 * fit.freedom


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Correction:
    """The fit that a correction would go on from, and how likely corrections to it are."""

    stack: EdgeStack
    base: OtfFit
    asked: Sequence[CorrectionEvidence]

    def likely(self, best: OtfFit, scatter: float) -> CorrectionEvidence | None:
        """The correction to take instead of the best fit without one; None for none.

        Of corrections that are about as likely, the richest: its band holds more lenses.
        """
        found = [one.log_likelihood(scatter) for one in self.asked]
        ahead = (_cost(self.base) - _cost(best)) / scatter + _BETTER
        if not found or max(found) < ahead:
            return None
        close = max(max(found) - _MUCH_BETTER, ahead)
        return max(
            (one for one, value in zip(self.asked, found, strict=True) if value >= close),
            key=lambda one: one.harmonics,
        )

    def fitted(self, best: OtfFit, scatter: float) -> OtfFit | None:
        """The fit with the correction to take instead of the best one; None for none."""
        evidence = self.likely(best, scatter)
        if evidence is None:
            return None
        return fit_correction(self.stack, self.base, evidence, scatter)

    def fitted_over_scatter(self, best: OtfFit, scatter: float) -> OtfFit | None:
        """A correction where edges differ from each other: of what they share, if that tells.

        Akaike's criterion must ask for it as well.
        """
        corrected = None if scatter > _TOO_SCATTERED else self.fitted(best, scatter)
        if corrected is None:
            return None
        gained = (best.squares - corrected.squares) / scatter
        asked = 2 * (corrected.freedom - best.freedom) + _MUCH_BETTER
        return corrected if gained >= asked else None


def _best(every: EdgeStack, plain: Sequence[OtfFit], correction: _Correction) -> _OtfChoice:
    """The form that the criteria choose, simplest first, settled over all edges."""
    richest = min(plain, key=_cost)
    corrected = correction.fitted(richest, 1.0)
    # Where the lens has no form of these, only a correction tells the scatter of the edges.
    telling = corrected or richest
    over_every = telling.over(every)
    scatter = max(dispersion(every, over_every), 1.0)

    def criterion(fit: OtfFit) -> float:
        return fit.squares / scatter + log(every.bins) * fit.freedom

    best = plain[0]
    for fit in plain[1:]:
        # Cameras have pixels; but a total Gaussian has no more parameters than one over them.
        margin = _MUCH_BETTER if fit.form.has_pixel else _BETTER
        if criterion(fit) < criterion(best) - margin:
            best = fit
    compared = [*plain, corrected] if corrected else plain
    if corrected is not None:
        if scatter > _SCATTERED:
            corrected = correction.fitted_over_scatter(best, scatter)
        best = corrected or best
    reason = ", ".join(
        f"{fit.form.label} {fit.squares / scatter:.0f} ({fit.freedom:.0f})" for fit in compared
    )
    if correction.stack is not every:
        best = settled(every, over_every if best is telling else best.over(every))
    reduced = best.squares / max(every.bins - best.freedom, 1.0)
    return _OtfChoice(
        fit=best,
        reason=f"chi2 over the edges' scatter (parameters): {reason}",
        scale=max(dispersion(every, best), reduced, 1.0),
        chi2_reduced=reduced,
        knows_turn=True,
    )


_ANGLES_DEG = tuple(range(0, 181, 15))
_FREQ_CY_PER_PX = tuple(round(0.02 * k, 2) for k in range(51))
_MTF50_FREQ = np.linspace(0.0, 2.0, 801)
_STEP_CY_PER_PX = 2.5e-3
_SOME_WAVES = 0.005  # less is none in two decimals
_AXES = ((0.0, "x"), (90.0, "y"))
_FULL_CORRECTION = CORRECTION_HARMONICS[-1]
_NO_APERTURE_PX = 1e-4  # a cut-off far beyond any frequency
_DECIMALS = 6  # of the table, which is there to be read
_DIGITS = 6  # of the covariance: with 8, bands are right to 1e-5 of themselves, with 6 to 1e-3


class OtfTable(StoredModel):
    """Samples of a transfer function of lens and pixel, and their standard errors.

    ``otf`` and ``otf_err`` have a row for each ``angle_deg`` of the frequency from +x, y down, and
    a column for each ``freq_cy_per_px``.
    """

    angle_deg: tuple[float, ...]
    freq_cy_per_px: tuple[float, ...]
    otf: tuple[tuple[float, ...], ...]
    otf_err: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _check(self) -> Self:
        shape = [len(self.freq_cy_per_px)] * len(self.angle_deg)
        for name, rows in (("otf", self.otf), ("otf_err", self.otf_err)):
            if [len(row) for row in rows] != shape:
                raise ValueError(
                    f"{name} must have {len(shape)} rows of {len(self.freq_cy_per_px)} numbers, "
                    "as there are angles and frequencies"
                )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledLens:
    """A lens's transfer without the pixel at frequencies in cycles per pixel, shape (n,) each.

    ``slopes``, shape ``(m, n)``, are its derivatives by parameters with this ``covariance``;
    ``weight`` is what each sample counts. ``gaussian_px2`` are the elements (xx, xy, yy) of a
    Gaussian about as wide.
    """

    fx: FloatArray
    fy: FloatArray
    transfer: FloatArray
    slopes: FloatArray
    covariance: FloatArray
    weight: FloatArray
    gaussian_px2: FloatArray


class Transfer2d(StoredModel):
    """Transfer function of lens and pixel over both axes, from the pixels of all edges at once.

    Or from those of ``pairs`` of photographs at two distances; then there are no edges.

    ``form`` and ``parameters`` say it whole; ``table`` is for programs that read no formula. A
    ``gaussian`` is of the lens, ``total-gaussian`` of lens and pixel, as rendered edges have;
    ``round`` is a circular pupil out of focus and a Gaussian, ``elliptic`` has its cut-off
    stretched, ``free`` a correction by radial splines and angular harmonics. ``covariance`` is the
    lower triangle, row by row, of the parameters' matrix, with the scatter from edge to edge and
    that of the focus between captures, widened by Student's quantile over the normal one.
    ``angles_deg`` are the edges' normals, modulo 180 degrees. ``scatter`` is a factor on the
    noise's covariance, at least 1. It and ``chi2_reduced`` are 1 for pairs, whose covariance holds
    their scatter. ``rho_err_assumed`` is in ``otf_err`` where the edges leave the correlation open
    and it is taken as 0.
    """

    form: FormName
    reason: str
    parameters: dict[str, float]
    covariance: tuple[tuple[float, ...], ...] = Field(repr=False)
    angles_deg: tuple[float, ...] = Field(repr=False)
    edges: int
    pairs: int = 0
    chi2_reduced: float
    scatter: float
    rho_err_assumed: float | None = None
    table: OtfTable | None = Field(default=None, repr=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        count = len(self.parameters)
        if [len(row) for row in self.covariance] != list(range(1, count + 1)):
            raise ValueError(
                f"covariance must have {count} rows of 1 to {count} numbers, as the parameters"
            )
        self._form.lens(self._values)
        return self

    @classmethod
    def of(
        cls, choice: _OtfChoice, normal_rad: Sequence[float], shared_err_px2: float = 0.0
    ) -> Self:
        """Return the document of a fit to edges with these normals and an error that they share."""
        fit = choice.fit
        by_variance = fit.form.by_variance
        shared = shared_err_px2**2 * np.outer(by_variance, by_variance)
        covariance = choice.scale * fit.inverse + shared
        bare = cls(
            form=fit.form.name,
            reason=choice.reason,
            parameters=dict(zip(fit.form.names, fit.parameters.tolist(), strict=True)),
            covariance=_lower_triangle(covariance),
            angles_deg=tuple(np.round(_distinct_directions_deg(normal_rad), 2).tolist()),
            edges=len(normal_rad),
            chi2_reduced=choice.chi2_reduced,
            scatter=choice.scale,
            rho_err_assumed=None if choice.knows_turn else USUAL_RHO,
        )
        return bare.model_copy(update={"table": bare._table()})

    @classmethod
    def of_sampled(cls, sampled: SampledLens, pairs: int) -> Self:
        """Return the document of a lens that is known by samples, from so many pairs.

        A Gaussian holds what it can, the form's correction the rest, with the covariance of it.
        """
        form = TWO_ELLIPSES.with_correction(_FULL_CORRECTION)
        elements = np.zeros(9)
        elements[[0, 2]] = _NO_APERTURE_PX
        elements[6:] = sampled.gaussian_px2
        shape = form.bounded(np.concatenate([form.nearest(elements), np.zeros(form.corrections)]))
        fx, fy = sampled.fx, sampled.fy
        turns = correction_harmonics(np.arctan2(fy, fx), _FULL_CORRECTION)
        splines = correction_splines(np.hypot(fx, fy))
        design = (turns[:, :, None] * splines[:, None, :]).reshape(fx.size, -1)
        inverse = np.linalg.pinv(design * sampled.weight[:, None]) * sampled.weight
        rest = inverse @ (sampled.transfer - form.lens(shape)(fx, fy))
        by_lens = inverse @ sampled.slopes.T
        covariance = np.zeros((shape.size, shape.size))
        covariance[-rest.size :, -rest.size :] = by_lens @ sampled.covariance @ by_lens.T
        shape[-rest.size :] = rest
        bare = cls(
            form=form.name,
            reason="the lens behind photographs at two distances",
            parameters=dict(zip(form.names, shape.tolist(), strict=True)),
            covariance=_lower_triangle(covariance),
            angles_deg=(),
            edges=0,
            pairs=pairs,
            chi2_reduced=1.0,
            scatter=1.0,
        )
        return bare.model_copy(update={"table": bare._table()})

    @property
    def lens(self) -> LensOtf:
        """Transfer function without the pixel: of the lens, or all of a total Gaussian."""
        return self._form.lens(self._values)

    @property
    def covariance_matrix(self) -> FloatArray:
        """Covariance matrix of the parameters, whole."""
        count = len(self.parameters)
        lower = np.zeros((count, count))
        lower[np.tril_indices(count)] = [value for row in self.covariance for value in row]
        return np.asarray(lower + np.tril(lower, -1).T)

    def psf(self, gaussian: GaussianPsf) -> GaussianPsf | MeasuredPsf:
        """Return the total PSF; ``gaussian`` is the Gaussian nearest to it."""
        if self._form.has_pixel:
            return MeasuredPsf(lens=self.lens, gaussian=gaussian)
        xx, xy, yy = self.lens.gaussian_px2
        return GaussianPsf.from_covariance(np.array([[xx, xy], [xy, yy]]))

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer of lens and pixel at frequencies; the two broadcast."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        return np.asarray(self.lens(fx, fy) * self._pixel(fx, fy))

    def otf_err(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the pointwise standard error of the transfer at frequencies; the two broadcast."""
        fx, fy = np.broadcast_arrays(fx_cy_per_px, fy_cy_per_px)
        slopes = self._form.otf_slopes(self._values, fx.ravel(), fy.ravel())
        variance = np.sum((slopes @ self.covariance_matrix) * slopes, axis=1)
        pixel = np.abs(self._pixel(fx, fy))
        measured = pixel * np.sqrt(np.maximum(variance, 0.0)).reshape(fx.shape)
        return np.asarray(np.hypot(measured, self._unknown_turn(fx, fy)))

    def _unknown_turn(self, fx: FloatArray, fy: FloatArray) -> FloatArray | float:
        """Change of the transfer if the correlation had the standard error that is assumed."""
        if self.rho_err_assumed is None:
            return 0.0
        halves = [self.mtf50_cy_per_px(angle) or _MTF50_FREQ[-1] for angle, _ in _AXES]
        widths = [np.sqrt(np.log(2) / 2) / np.pi / half for half in halves]
        xy_px2 = self.rho_err_assumed * widths[0] * widths[1]
        return np.asarray(4 * np.pi**2 * fx * fy * xy_px2 * self.otf(fx, fy))

    def mtf50_err_cy_per_px(self, angle_deg: float) -> float | None:
        """Return the standard error of the MTF50; None where there is none up to 2 cy/px."""
        half = self.mtf50_cy_per_px(angle_deg)
        if half is None:
            return None
        angle = np.deg2rad(angle_deg)
        freq = half + np.array([-_STEP_CY_PER_PX, 0.0, _STEP_CY_PER_PX])
        fx, fy = freq * np.cos(angle), freq * np.sin(angle)
        values, errs = np.abs(self.otf(fx, fy)), self.otf_err(fx, fy)
        fall = (values[0] - values[2]) / (2 * _STEP_CY_PER_PX)
        return float(errs[1] / fall)

    def mtf50_cy_per_px(self, angle_deg: float) -> float | None:
        """Return the frequency at which the contrast falls to a half; None for none up to 2 cy/px.

        ``angle_deg`` is the direction of the frequency from +x, y down.
        """
        angle = np.deg2rad(angle_deg)
        values = np.abs(self.otf(_MTF50_FREQ * np.cos(angle), _MTF50_FREQ * np.sin(angle)))
        below = np.flatnonzero(values < 0.5)
        if below.size == 0:
            return None
        pair = slice(below[0] - 1, below[0] + 1)
        return float(np.interp(-0.5, -values[pair], _MTF50_FREQ[pair]))

    @property
    def measured_on(self) -> str:
        """Whose pixels told it, in words."""
        return "the photographs" if self.pairs else "all edges"

    @property
    def defocus_waves(self) -> float:
        """Defocus of the pupil in wavelengths, its mean square over directions; 0 without one."""
        xx, _, yy = self.lens.defocus_waves2
        return float(np.sqrt(0.5 * (xx + yy)))

    def _pixel(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """What the square pixel passes; 1 where the form contains it."""
        return np.asarray(np.sinc(fx) * np.sinc(fy)) if self._form.has_pixel else np.ones_like(fx)

    def _table(self) -> OtfTable:
        angle = np.deg2rad(_ANGLES_DEG)[:, None]
        freq = np.array(_FREQ_CY_PER_PX)
        fx, fy = freq * np.cos(angle), freq * np.sin(angle)
        return OtfTable(
            angle_deg=tuple(float(angle) for angle in _ANGLES_DEG),
            freq_cy_per_px=_FREQ_CY_PER_PX,
            otf=_rows(np.round(self.otf(fx, fy), _DECIMALS)),
            otf_err=_rows(np.round(self.otf_err(fx, fy), _DECIMALS)),
        )

    @property
    def _form(self) -> OtfForm:
        return form_of(self.form, tuple(self.parameters))

    @property
    def _values(self) -> FloatArray:
        return np.array(list(self.parameters.values()))

    def __str__(self) -> str:
        focus = f" (defocus {self.defocus_waves:.2f} waves)" * (self.defocus_waves >= _SOME_WAVES)
        between = "" if self.rho_err_assumed is None else "; between the axes not measured"
        halves = [f"{_brief(self.mtf50_cy_per_px(angle))} along {axis}" for angle, axis in _AXES]
        source = f"{self.edges} edges at {len(self.angles_deg)} angles"
        if self.pairs:
            source = f"{self.pairs} pair{'s' * (self.pairs > 1)} of photographs"
        return f"{self.form}{focus}, from {source}; MTF50 in cy/px: {', '.join(halves)}{between}"


def measure_transfer_2d(
    edges: Sequence[BinnedEdge], shared_err_px2: float = 0.0, *, knows_correlation: bool = True
) -> Transfer2d | None:
    """Fit the two-dimensional transfer function.

    ``shared_err_px2`` is an error of the variance, of both axes alike, that edges share and so do
    not show by their scatter: the focus of a capture, what JPEG takes from all; 1.96 of it are 95
    %. Where rho is undetermined every form is upright. None where the edges have one direction
    alone, or two that are not those of vertical and horizontal edges.
    """
    choice = _choose_otf(edges, knows_correlation=knows_correlation)
    if choice is None:
        return None
    return Transfer2d.of(choice, [edge.normal_rad for edge in edges], shared_err_px2)


def _brief(freq_cy_per_px: float | None) -> str:
    return "beyond 2" if freq_cy_per_px is None else f"{freq_cy_per_px:.3f}"


def _lower_triangle(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Rows up to the diagonal, with the digits that a band needs."""
    return tuple(
        tuple(float(f"{value:.{_DIGITS}g}") for value in row[: k + 1])
        for k, row in enumerate(matrix.tolist())
    )


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
