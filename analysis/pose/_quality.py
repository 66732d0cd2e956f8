"""Whether a follow-up's pose is good enough: a map of d' over the frame, and a verdict.

The verdict is go, no go or unsure, by the probability that d' reaches the threshold.
"""

from dataclasses import dataclass, replace
from math import atan2, degrees, hypot
from typing import TYPE_CHECKING, Final, Literal, Self

import numpy as np
from pydantic import Field
from scipy.optimize import brentq

from acquisition.dataframe import dataframe
from acquisition.files import Provenance
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json
from analysis.choices import Criterion
from analysis.detectability import (
    SOURCE_WORDS,
    BudgetShare,
    CurveChoice,
    DetectabilityCurve,
    Source,
    focus_spread,
)
from analysis.detection_limits import DetectionLimit
from analysis.errors import AnalysisError, OverlapError, ResultsFileError
from analysis.pose._limits import LocalSampling, local_sampling
from analysis.pose._parallax import ParallaxCost, PoseParallax
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import fitted, read_document
from calibration.registration import DistortedPose
from simulation.arguments import FilePath, checked, path_of
from simulation.arrays import BoolArray, FloatArray
from simulation.by_value import ByValue
from simulation.notebook import Shown
from simulation.pose import DepthSampling

if TYPE_CHECKING:
    from pandas import DataFrame


Verdict = Literal["go", "no go", "unsure"]

CONFIDENCE: Final = 0.95
"""Probability from which a verdict is given: go where d' reaches the threshold with it, no go where
it falls short with it."""

_MOST_SCATTER_PX2 = 1.0
"""A focus that scatters more changes the PSF of most lenses beyond what slopes describe."""
_TRIED_PX2 = np.geomspace(0.002, _MOST_SCATTER_PX2, 14).tolist()

_REMEDIES: Final[dict[Source, str]] = {
    "scene": "more photographs of the scene",
    "psf": "more edges, frames and captures for the PSF",
    "focus": "a focus that repeats better, or the mean of several captures",
    "noise": "more frames for the noise",
    "registration": "more texture, or points, to register by",
}


class PoseDecision(StoredValues):
    """How sure a verdict on a pose is.

    Parameters
    ----------
    verdict
        ``go`` if d' reaches the threshold with a probability of 95 % or more, ``no go`` if with 5 %
        or less, otherwise ``unsure``.
    probability
        Probability that d' reaches the threshold.
    dprime_interval_95
        95 % interval of the decisive d'.
    budget
        Shares of the sources of error in the variance of ln d', the largest first.
    unknown_sources
        Sources of error that are not known and that neither interval nor verdict includes.
    focus_turning_px2
        If the focus scatter is not known: the least scatter that would change the verdict; None if
        none up to 1 px^2 would.
    """

    verdict: Verdict
    probability: float
    dprime_interval_95: tuple[float, float]
    budget: tuple[BudgetShare, ...]
    unknown_sources: tuple[Source, ...] = ()
    focus_turning_px2: float | None = None

    @property
    def sentence(self) -> str:
        """The probability of the verdict, what decides it, and what would make it more certain."""
        low, high = self.dprime_interval_95
        said = f"{self.probability_text}; d' {low:.2f} to {high:.2f} (95 %)"
        if not self.budget or self.budget[0].share == 0:
            return f"{said}; nothing is known of its errors"
        first = self.budget[0]
        said += f", {100 * first.share:.0f} % of it from {SOURCE_WORDS[first.source]}"
        if self.verdict == "unsure":
            said += f"; {_REMEDIES[first.source]} would narrow it"
        return said

    @property
    def probability_text(self) -> str:
        """The probability in words, never as certain as a rounded 100 %."""
        percent = 100 * self.probability
        if percent > 99.9:
            return "d' reaches the threshold with a probability of more than 99.9 %"
        if percent < 0.1:
            return "d' reaches the threshold with a probability of less than 0.1 %"
        return f"d' reaches the threshold with a probability of {percent:.3g} %"

    @property
    def unknown_sentence(self) -> str | None:
        """The errors that the verdict does not include; None if all sources are known."""
        if not self.unknown_sources:
            return None
        named = " and ".join(SOURCE_WORDS[name] for name in self.unknown_sources)
        said = f"unknown, and so not included: {named}"
        if "focus" not in self.unknown_sources:
            return said
        if self.focus_turning_px2 is None:
            return (
                f"{said}; no scatter of the focus up to {_MOST_SCATTER_PX2:g} px^2 would change "
                "the verdict"
            )
        return (
            f"{said}; with a focus that scatters by {self.focus_turning_px2:.2g} px^2 or more the "
            f"verdict is {'no go' if self.verdict == 'unsure' else 'unsure'}"
        )


def decide(
    curve: DetectabilityCurve, zoom: float, d_prime: float, min_d_prime: float
) -> PoseDecision:
    """Decide on a d' that was read off a curve.

    ``d_prime``: as read; 0 beyond the curve.
    """
    errors = curve.errors_at(zoom)
    probability = errors.probability_of(min_d_prime, d_prime)
    verdict = verdict_of(probability)
    unknown = () if curve.uncertainty is None else curve.uncertainty.sources.unknown
    turning = None
    if "focus" in unknown:
        turning = _turning_scatter(curve, zoom, d_prime, min_d_prime, verdict)
    return PoseDecision(
        verdict=verdict,
        probability=probability,
        dprime_interval_95=errors.interval(d_prime),
        budget=errors.budget,
        unknown_sources=unknown,
        focus_turning_px2=turning,
    )


def verdict_of(probability: float) -> Verdict:
    """Return the verdict for the probability that d' reaches the threshold."""
    if probability >= CONFIDENCE:
        return "go"
    return "no go" if probability <= 1 - CONFIDENCE else "unsure"


def _turning_scatter(
    curve: DetectabilityCurve, zoom: float, d_prime: float, min_d_prime: float, verdict: Verdict
) -> float | None:
    """Least scatter of the focus that turns a verdict; None for none, or beyond the curve."""
    assert curve.uncertainty is not None
    if d_prime <= 0:
        return None
    errors = curve.errors_at(zoom)
    slopes = curve.uncertainty.slopes_at(curve.zoom, zoom)

    def probability(scatter_px2: float) -> float:
        focus = focus_spread(slopes, scatter_px2)
        spreads = {**errors.spreads, "focus": focus}
        return replace(errors, spreads=spreads).probability_of(min_d_prime, d_prime)

    before, turned = 0.0, verdict
    for scatter_px2 in _TRIED_PX2:
        turned = verdict_of(probability(scatter_px2))
        if turned != verdict:
            break
        before = scatter_px2
    else:
        return None
    bound = CONFIDENCE if "go" in (verdict, turned) else 1 - CONFIDENCE
    return float(brentq(lambda s: probability(s) - bound, before, scatter_px2, xtol=1e-4))


_Row3 = tuple[float, float, float]

QUANTILE = 0.05
"""Share of the overlap that may lie below the threshold by criterion ``quantile``."""


class PoseSummary(Shown, StoredValues):
    """A verdict on a pose in figures: what ``standoff pose --json`` prints.

    Parameters
    ----------
    is_accepted, criterion, min_dprime, curve
        Whether the pose is accepted; criterion, threshold and curve by which it was judged.
    is_upper_bound
        Whether d' is an upper bound; always true.
    dprime_decisive, dprime_min, dprime_max
        The d' that the criterion compares with the threshold; the least and the largest d' in the
        overlap.
    zoom_min, zoom_max, anisotropy_max
        Extremes of the local zoom in the overlap, and of its ratio between two directions.
    overlap
        Share of the follow-up that the reference covers.
    beyond_curve
        Share of the overlap whose local zoom the curve does not reach.
    homography, registration_correlation
        The homography, for a distorting lens the one nearest to the pose; and the correlation of
        the two photographs, None if they were not registered.
    warnings
        Sentences on what to check in the alignment.
    verdict, probability, dprime_interval_95, budget, unknown_sources, focus_turning_px2
        How sure the verdict is, as in `PoseDecision`; None in older documents.
    detection_limit
        What a comparison of the two photographs would have found; None if they were not compared.
    parallax
        What the depth of the scene costs; None where a plane explains the two photographs, or they
        were not compared. Then d' is of what both photographs show.
    picture
        Name of the map that was drawn.
    provenance
        Program, arguments and input files that the verdict was made with.
    """

    is_accepted: bool
    criterion: Criterion
    min_dprime: float
    curve: CurveChoice
    is_upper_bound: bool = True
    dprime_decisive: float
    dprime_min: float
    dprime_max: float
    zoom_min: float
    zoom_max: float
    anisotropy_max: float
    overlap: float
    beyond_curve: float
    homography: tuple[_Row3, _Row3, _Row3]
    registration_correlation: float | None = None
    warnings: tuple[str, ...] = ()
    verdict: Verdict | None = None
    probability: float | None = None
    dprime_interval_95: tuple[float, float] | None = None
    budget: tuple[BudgetShare, ...] = ()
    unknown_sources: tuple[Source, ...] = ()
    focus_turning_px2: float | None = None
    detection_limit: DetectionLimit | None = None
    parallax: PoseParallax | None = None
    picture: str | None = None
    provenance: Provenance | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PoseQuality(ByValue):
    """Verdict on a pose, with a map of d' over the follow-up.

    Parameters
    ----------
    matrix, curve
        The homography, and the curve by which it was judged.
    sampling
        How densely the follow-up samples the reference, by position.
    d_prime
        Map of d' in the shape of the maps of ``sampling``; an upper bound; 0 where the local zoom
        is beyond the curve, NaN outside the reference and where depth hides the scene.
    decisive_d_prime
        The value that the criterion compares with the threshold ``min_d_prime``: the least d', or
        its quantile.
    beyond_curve
        Share of the overlap whose local zoom the curve does not reach.
    decision
        How sure the verdict is.
    """

    matrix: FloatArray
    curve: DetectabilityCurve
    sampling: LocalSampling
    d_prime: FloatArray
    decisive_d_prime: float
    min_d_prime: float
    criterion: Criterion
    beyond_curve: float
    decision: PoseDecision

    @property
    def is_accepted(self) -> bool:
        """Whether d' reaches the threshold by the criterion."""
        return self.decisive_d_prime >= self.min_d_prime

    @property
    def beyond_curve_sentence(self) -> str:
        """How much of the overlap the curve does not reach."""
        return (
            f"{100 * self.beyond_curve:.0f} % of the overlap lies beyond the curve's zoom of "
            f"{self.curve.zoom[-1]:g}; its d' is taken as 0"
        )

    def __repr__(self) -> str:
        return (
            f"<PoseQuality: {self.decision.verdict}, {self.criterion} d' "
            f"{self.decisive_d_prime:.2f}, threshold {self.min_d_prime:g}>"
        )

    @property
    def summary(self) -> PoseSummary:
        """The verdict in figures."""
        inside = self.sampling.inside
        return PoseSummary(
            is_accepted=self.is_accepted,
            criterion=self.criterion,
            min_dprime=self.min_d_prime,
            curve=self.curve.choice,
            dprime_decisive=self.decisive_d_prime,
            dprime_min=float(np.nanmin(self.d_prime)),
            dprime_max=float(np.nanmax(self.d_prime)),
            zoom_min=float(self.sampling.best_zoom[inside].min()),
            zoom_max=float(self.sampling.worst_zoom[inside].max()),
            anisotropy_max=float(self.sampling.anisotropy[inside].max()),
            overlap=self.sampling.overlap,
            beyond_curve=self.beyond_curve,
            homography=self.matrix.tolist(),
            **{name: getattr(self.decision, name) for name in PoseDecision.model_fields},
        )


def pose_quality(
    matrix: FloatArray,
    followup_size: tuple[int, int],
    reference_size: tuple[int, int],
    curve: DetectabilityCurve,
    min_d_prime: float,
    criterion: Criterion = "min",
) -> PoseQuality:
    """Judge a pose by the curve's d' at the local zoom of the worse direction.

    ``matrix``: shape (3, 3): follow-up pixel centres to reference pixel centres. ``followup_size,
    reference_size``: ``(width, height)``. ``criterion``: ``min``: d' reaches the threshold
    everywhere in the overlap; ``quantile``: in all but 5 % of it.
    """
    try:
        sampling = local_sampling(matrix, followup_size, reference_size)
    except ValueError as error:
        raise AnalysisError(str(error)) from error
    if not sampling.inside.any():
        raise OverlapError("the follow-up shows nothing of the reference", shared_px=0)
    return _judged(matrix, sampling, sampling.inside, curve, (min_d_prime, criterion))


def quality_of_scene(
    sampling: DepthSampling, curve: DetectabilityCurve, min_d_prime: float, criterion: Criterion
) -> PoseQuality:
    """Judge a pose before a scene whose depth is known, by what both photographs show.

    The zoom of each pixel is that of the surface that it sees; elsewhere it is the plane's.
    """
    view, seen = sampling.view, sampling.seen
    matrix = np.asarray(np.linalg.inv(view.plane), dtype=np.float64)
    (rows, cols), (own_rows, own_cols) = view.follow_up, view.reference
    try:
        plane = local_sampling(matrix, (cols, rows), (own_cols, own_rows), step_px=1)
    except ValueError as error:
        raise AnalysisError(str(error)) from error
    worst, best = sampling.zooms()
    is_judged = np.isfinite(worst)
    if not is_judged.any():
        raise OverlapError("the follow-up shows nothing of the reference", shared_px=0)
    with_depth = LocalSampling(
        worst_zoom=np.where(is_judged, worst, plane.worst_zoom),
        best_zoom=np.where(is_judged, best, plane.best_zoom),
        inside=~seen.outside,
    )
    return _judged(matrix / matrix[2, 2], with_depth, is_judged, curve, (min_d_prime, criterion))


def quality_with_depth(
    quality: PoseQuality, curve: DetectabilityCurve, parallax: ParallaxCost
) -> PoseQuality:
    """Judge a pose again, of a scene with depth: by what both photographs show.

    ``curve``: that of ``quality``, with the errors of places that follow from the parallax.
    """
    sampling = quality.sampling
    rows, cols = (
        np.rint(np.linspace(0, most - 1, count)).astype(np.intp)
        for most, count in zip(parallax.is_hidden.shape, sampling.inside.shape, strict=True)
    )
    is_judged = sampling.inside & ~parallax.is_hidden[np.ix_(rows, cols)]
    if not is_judged.any():
        is_judged = sampling.inside
    demand = quality.min_d_prime, quality.criterion
    return _judged(quality.matrix, sampling, is_judged, curve, demand)


def _judged(
    matrix: FloatArray,
    sampling: LocalSampling,
    is_judged: BoolArray,
    curve: DetectabilityCurve,
    demand: tuple[float, Criterion],
) -> PoseQuality:
    """Judge by the d' at these places of a sampling; ``demand``: threshold and criterion."""
    min_d_prime, criterion = demand
    known = curve.d_prime_at(sampling.worst_zoom)
    is_beyond = np.isnan(known)
    # Whatever d' is there, it is below the curve's last value and not known to be enough.
    d_prime = np.where(is_beyond, 0.0, known)
    seen = d_prime[is_judged]
    rank = 0 if criterion == "min" else int(QUANTILE * (len(seen) - 1))
    place = int(np.argpartition(seen, rank)[rank])
    decisive, zoom = float(seen[place]), float(sampling.worst_zoom[is_judged][place])
    return PoseQuality(
        matrix=matrix,
        curve=curve,
        sampling=sampling,
        d_prime=np.where(is_judged, d_prime, np.nan),
        decisive_d_prime=decisive,
        min_d_prime=min_d_prime,
        criterion=criterion,
        beyond_curve=float(is_beyond[is_judged].mean()),
        decision=decide(curve, zoom, decisive, min_d_prime),
    )


@checked
def read_pose(path: FilePath) -> PoseSummary:
    """Read what ``standoff pose --json`` printed for one follow-up.

    Parameters
    ----------
    path
        Path of a file with that output, or with ``to_json`` of the result of ``judge_pose``.

    Returns
    -------
    PoseSummary
        The verdict in figures.

    Raises
    ------
    ResultsFileError
        If it cannot be read, or a value is missing or wrong.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> judged = standoff.judge_pose("before.tif", "after.tif", "curves.json", 2)
    >>> _ = Path("pose.json").write_text(json.dumps(judged.to_json()))
    >>> standoff.read_pose("pose.json") == judged.summary
    True
    """
    path = path_of(path, "path")
    source = str(path)
    what = "this is not what standoff pose --json prints for one follow-up"
    try:
        document = parse_json(read_regular_file(path))
    except OSError as error:
        raise ResultsFileError(f"cannot read {path}: {error.strerror}", source=source) from error
    except ValueError as error:
        raise ResultsFileError(f"{path}: {what}", source=source) from error
    try:
        return fitted(document, PoseSummary, ResultsFileError, source)
    except ResultsFileError as error:
        raise ResultsFileError(f"{error}; {what}", source=source, key=error.key) from error


_POSE_SERIES_SCHEMA: Final = "standoff.pose-summary/1"


class JudgedFollowup(StoredValues):
    """One follow-up: a row of poses.csv, which leaves out the homography.

    Values that are not described here are those of `PoseSummary`; None if the follow-up could not
    be judged.

    Parameters
    ----------
    followup, sha256
        The file, and the hash of its bytes if it could be read.
    refused
        Why it could not be judged; None if it was.
    """

    followup: str
    sha256: str | None = None
    is_accepted: bool | None = None
    dprime_decisive: float | None = None
    dprime_min: float | None = None
    dprime_max: float | None = None
    zoom_min: float | None = None
    zoom_max: float | None = None
    anisotropy_max: float | None = None
    overlap: float | None = None
    beyond_curve: float | None = None
    registration_correlation: float | None = None
    verdict: Verdict | None = None
    probability: float | None = None
    homography: tuple[_Row3, _Row3, _Row3] | None = None
    refused: str | None = None

    @classmethod
    def of(cls, followup: str, sha256: str | None, judged: PoseSummary) -> Self:
        """Return the follow-up with the figures of its verdict."""
        own = judged.model_dump(include=set(cls.model_fields))
        return cls(followup=followup, sha256=sha256, **own)


class PoseSeries(ResultsDocument):
    """Several follow-ups of one reference, in the order of their paths.

    ``accepted``, ``rejected`` and ``refused`` are numbers of follow-ups; a refused one could not be
    read or registered. ``unsure`` is the number of those, accepted or rejected, whose verdict is
    ``unsure``. The provenance lists the shared inputs; each follow-up has its own hash.
    """

    schema_name: Literal["standoff.pose-summary/1"] = Field(
        default=_POSE_SERIES_SCHEMA, alias="schema"
    )
    reference: str
    criterion: Criterion
    min_dprime: float
    curve: CurveChoice
    is_upper_bound: bool = True
    accepted: int
    rejected: int
    refused: int
    unsure: int | None = None
    followups: tuple[JudgedFollowup, ...] = ()

    def to_dataframe(self) -> "DataFrame":
        """Return the follow-ups as a pandas table, one row per follow-up.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.model_dump() for one in self.followups)


@checked
def read_pose_series(path: FilePath) -> PoseSeries:
    """Read the summary.json of ``standoff pose`` with several follow-ups.

    Parameters
    ----------
    path
        Path of the file, in the folder that ``judge_poses`` wrote.

    Returns
    -------
    PoseSeries
        A verdict for each follow-up.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> judged = standoff.judge_poses("before.tif", "after", "poses", "curves.json", 2)
    >>> standoff.read_pose_series(judged.summary).accepted
    2
    """
    remedy = "write it with standoff pose and several follow-ups"
    return read_document(path, PoseSeries, ResultsFileError, remedy)


_SAME = 0.005  # relative; a zoom of half a per cent is not worth a word


def describe_pose(pose: DistortedPose) -> str:
    """Say where a follow-up was taken from, relative to its reference, in an operator's words."""
    rows, cols = pose.followup_shape
    middle_y, middle_x = (rows - 1) / 2, (cols - 1) / 2
    y, x = pose.to_reference_px(
        np.array([middle_y, middle_y]), np.array([middle_x - 0.5, middle_x + 0.5])
    )
    reference_rows, reference_cols = pose.reference_shape
    aside_px = hypot(
        float(x.mean()) - (reference_cols - 1) / 2, float(y.mean()) - (reference_rows - 1) / 2
    )
    turn_deg = degrees(atan2(float(y[1] - y[0]), float(x[1] - x[0])))
    return (
        f"{_distance_text(pose.zoom)}, turned by {turn_deg:.1f} degrees, aside by "
        f"{aside_px:.0f} px ({100 * aside_px / reference_cols:.0f} % of the frame)"
    )


def _distance_text(zoom: float) -> str:
    if abs(zoom - 1) < _SAME:
        return f"the same distance (zoom {zoom:.3f})"
    return f"{'further away' if zoom > 1 else 'nearer'} (zoom {zoom:.3f})"
