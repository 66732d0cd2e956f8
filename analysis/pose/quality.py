"""Whether a follow-up's pose is good enough: a map of d' over the frame, and a verdict."""

from dataclasses import dataclass

import numpy as np

from acquisition.files import Provenance
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json
from analysis.choices import Criterion
from analysis.detectability import BudgetShare, CurveChoice, DetectabilityCurve, Source
from analysis.detection_limits import DetectionLimit
from analysis.errors import AnalysisError, OverlapError, ResultsFileError
from analysis.pose.decision import PoseDecision, Verdict, decide
from analysis.pose.local_sampling import LocalSampling, local_sampling
from analysis.results_file import StoredValues
from calibration.documents import fitted
from simulation.arguments import FilePath, checked, path_of
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.notebook import Shown

_Row3 = tuple[float, float, float]

QUANTILE = 0.05
"""Share of the overlap that may lie below the threshold by criterion ``quantile``."""


class PoseSummary(Shown, StoredValues):
    """A verdict on a pose in figures: what ``standoff pose --json`` prints.

    Parameters
    ----------
    is_accepted, criterion, min_dprime, curve
        The verdict, and what it was judged by.
    is_upper_bound
        Whether d' is an upper bound; always true.
    dprime_decisive, dprime_min, dprime_max
        What the criterion looked at; the least and the largest d' of the overlap.
    zoom_min, zoom_max, anisotropy_max
        Of the local sampling in the overlap.
    overlap
        Share of the follow-up that the reference covers.
    beyond_curve
        Share of the overlap whose local zoom the curve does not reach.
    homography, registration_correlation
        The pose, for a distorting lens the homography nearest to it; and how well the images agreed
        on it where they were registered.
    warnings
        Sentences on what to check of the alignment.
    verdict, probability, dprime_interval_95, budget, unknown_sources, focus_turning_px2
        How sure that is, as in `PoseDecision`; None in documents of before.
    detection_limit
        What a comparison of the two photographs would have found, where they were compared.
    picture
        Name of the map that was drawn.
    provenance
        Where a printed verdict comes from.
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
    picture: str | None = None
    provenance: Provenance | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PoseQuality(ByValue):
    """Verdict on a pose.

    Parameters
    ----------
    matrix, curve
        The pose and the curve it was judged by.
    sampling
        How densely the follow-up samples the reference, by position.
    d_prime
        Shape of the sampling's maps; an upper bound; 0 where the local zoom lies beyond the
        curve, NaN outside the reference.
    decisive_d_prime
        What the criterion looks at: the least value, or the quantile.
    min_d_prime, criterion
        What was asked for.
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


def judge_pose(
    matrix: FloatArray,
    followup_size: tuple[int, int],
    reference_size: tuple[int, int],
    curve: DetectabilityCurve,
    min_d_prime: float,
    criterion: Criterion = "min",
) -> PoseQuality:
    """Judge a pose by the curve's d' at the local zoom of the worse direction.

    Parameters
    ----------
    matrix
        Shape (3, 3): follow-up pixel centres to reference pixel centres.
    followup_size, reference_size
        ``(width, height)``.
    curve
        d' against zoom.
    min_d_prime
        Threshold.
    criterion
        ``min``: d' reaches the threshold everywhere in the overlap; ``quantile``: in all but
        5 % of it.

    Raises
    ------
    OverlapError
        If the follow-up shows nothing of the reference.
    AnalysisError
        If it sees the plane's horizon.
    """
    try:
        sampling = local_sampling(matrix, followup_size, reference_size)
    except ValueError as error:
        raise AnalysisError(str(error)) from error
    if not sampling.inside.any():
        raise OverlapError("the follow-up shows nothing of the reference", shared_px=0)
    known = curve.d_prime_at(sampling.worst_zoom)
    is_beyond = np.isnan(known)
    # Whatever d' is there, it is below the curve's last value and not known to be enough.
    d_prime = np.where(is_beyond, 0.0, known)
    seen = d_prime[sampling.inside]
    rank = 0 if criterion == "min" else int(QUANTILE * (len(seen) - 1))
    place = int(np.argpartition(seen, rank)[rank])
    decisive, zoom = float(seen[place]), float(sampling.worst_zoom[sampling.inside][place])
    return PoseQuality(
        matrix=matrix,
        curve=curve,
        sampling=sampling,
        d_prime=np.where(sampling.inside, d_prime, np.nan),
        decisive_d_prime=decisive,
        min_d_prime=min_d_prime,
        criterion=criterion,
        beyond_curve=float(is_beyond[sampling.inside].mean()),
        decision=decide(curve, zoom, decisive, min_d_prime),
    )


@checked
def read_pose(path: FilePath) -> PoseSummary:
    """Read what ``standoff pose --json`` printed for one follow-up.

    Parameters
    ----------
    path
        Of the file: its output, or ``to_json`` of the result of ``judge_pose``.

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
