"""Detectability at a pose that is known: of a homography, without photographs."""

from dataclasses import dataclass
from functools import cached_property
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from acquisition.provenance import Provenance
from analysis.choices import Criterion
from analysis.detectability import CurveChoice
from analysis.pose import QUANTILE, PoseQuality, judge_pose
from analysis.reports import plot_pose
from calibration.registration import DistortedPose, Homography
from simulation.arguments import checked
from simulation.by_value import ByValue
from simulation.notebook import Shown
from standoff.errors import ArgumentError
from standoff.library.call import Call
from standoff.library.detectability.limits import CurveLike, given_curve
from standoff.library.followup import given_homography, refuse_giant_frame
from standoff.library.inputs import FilePath

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)  # without slots: keeps results
class JudgedHomography(Shown, ByValue):
    """d' over a follow-up whose pose is known, and the verdict by the curve.

    Parameters
    ----------
    quality
        The maps and the verdict.
    reference_size, followup_size
        ``(width, height)`` in px.
    notes
        What there is to say of it, in sentences.
    """

    quality: PoseQuality
    reference_size: tuple[int, int]
    followup_size: tuple[int, int]
    provenance: Provenance
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<JudgedHomography: {self.sentence}>"

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a map of d' over the follow-up."""
        return plot_pose(None, self.quality, ax)

    @property
    def is_accepted(self) -> bool:
        """Whether d' reaches the threshold."""
        return self.quality.is_accepted

    @cached_property
    def dprime_median(self) -> float:
        """Median of d' over the overlap."""
        return float(np.nanmedian(self.quality.d_prime))

    @cached_property
    def dprime_quantile(self) -> float:
        """Value of d' that all but 5 % of the overlap reach."""
        seen = self.quality.d_prime[self.quality.sampling.inside]
        return float(np.quantile(seen, QUANTILE, method="lower"))

    @cached_property
    def zoom_median(self) -> float:
        """Median over the overlap of the local zoom, along the coarser direction."""
        sampling = self.quality.sampling
        return float(np.median(sampling.worst_zoom[sampling.inside]))

    def to_json(self) -> dict[str, Any]:
        """Return the figures as ``standoff limits --homography --json`` prints them.

        They are those of ``standoff pose --json``, with medians, the quantile and the sizes.
        """
        summary = self.quality.summary.model_copy(update={"provenance": self.provenance})
        return {
            **summary.model_dump(mode="json"),
            "dprime_median": self.dprime_median,
            "dprime_quantile": self.dprime_quantile,
            "zoom_median": self.zoom_median,
            "reference_size": list(self.reference_size),
            "followup_size": list(self.followup_size),
        }

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        quality, summary = self.quality, self.quality.summary
        verdict = "accepted" if quality.is_accepted else "rejected"
        return (
            f"{verdict}: d' {summary.dprime_min:.3g} at least, {self.dprime_median:.3g} in the "
            f"median and {self.dprime_quantile:.3g} or more in 95 % of the overlap, threshold "
            f"{quality.min_d_prime:g} ({quality.criterion}); local zoom {summary.zoom_min:.3f} to "
            f"{summary.zoom_max:.3f}, overlap {100 * summary.overlap:.0f} %"
        )


@checked
def judge_homography(
    homography: ArrayLike | Homography | FilePath,
    curve: CurveLike,
    min_d_prime: float,
    *,
    choice: CurveChoice | None = None,
    size: tuple[int, int] | None = None,
    reference_size: tuple[int, int] | None = None,
    criterion: Criterion = "min",
    focus_scatter_px2: float | None = None,
) -> JudgedHomography:
    """Judge a pose that is known, without photographs.

    Parameters
    ----------
    homography
        Maps follow-up pixels ``(x, y, 1)`` to reference pixels: shape (3, 3), or the path of an
        H.json.
    curve
        One of the curves of ``d_prime_curves``, or a curves.json.
    min_d_prime
        The threshold.
    choice
        Which curve, if there are several.
    size
        ``(width, height)`` of the follow-up, for a bare matrix; that of H.json otherwise.
    reference_size
        ``(width, height)`` of the reference; by default that of the follow-up.
    criterion
        ``min``: d' reaches the threshold everywhere in the overlap; ``quantile``: in all but 5 %.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture, instead of the curve's.

    Returns
    -------
    JudgedHomography
        d' over the frame, local zoom, overlap and the verdict; d' is an upper bound.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ArgumentError
        If several curves are meant, or a size is missing.
    AnalysisError
        If the follow-up sees nothing of the reference, or the plane's horizon.
    CalibrationError
        If H.json cannot be read.

    Examples
    --------
    >>> standoff.judge_homography("H.json", "curves.json", 2.0).is_accepted
    True
    """
    is_file = isinstance(homography, str | PathLike)
    if size is None and not (is_file or isinstance(homography, Homography)):
        raise ArgumentError("a matrix does not say how large the follow-up is; give size")
    found = given_curve(curve, min_d_prime, choice, focus_scatter_px2)
    files = [one for one in (homography, curve) if isinstance(one, str | PathLike)]
    call = Call("judge_homography", files=files)
    pose = given_homography(homography, size or (1, 1))
    followup_size = size or pose.size
    frame = reference_size or followup_size
    refuse_giant_frame(frame, "reference_size")
    matrix = pose.matrix
    if pose.distortion_k1 != 0:
        whole = DistortedPose(
            matrix=matrix,
            k1=pose.distortion_k1,
            reference_shape=(frame[1], frame[0]),
            followup_shape=(followup_size[1], followup_size[0]),
        )
        matrix = whole.nearest_homography()
        named = fspath(homography) if isinstance(homography, str | PathLike) else "homography"
        call.note(f"{named}: judged by the homography nearest to it and its lens's distortion")
    quality = judge_pose(matrix, followup_size, frame, found, min_d_prime, criterion)
    if quality.beyond_curve > 0:
        call.note(quality.beyond_curve_sentence)
    return JudgedHomography(
        quality=quality,
        reference_size=frame,
        followup_size=followup_size,
        provenance=call.provenance(),
        notes=call.notes,
    )
