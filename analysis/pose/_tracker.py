"""A live verdict on the camera's pose: whether a follow-up taken from here is good enough.

No files, no clock, no camera: an image goes in, a verdict comes out. The pose is followed from
frame to frame against the reference itself; a full search of the frame (an *anchor*) happens at
the first frame and whenever the pose was lost.
"""

from dataclasses import dataclass, field

import numpy as np

from analysis.choices import Criterion
from analysis.detectability import DetectabilityCurve
from analysis.errors import AnalysisError
from analysis.pose._quality import PoseQuality, Verdict, pose_quality
from calibration.errors import RegistrationError
from calibration.registration import TrackedPose, TrackingReference
from simulation.arrays import AnyArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseVerdict:
    """Verdict on the pose of one frame.

    Parameters
    ----------
    accepted
        Whether d' reaches the threshold by the criterion; False where the pose is not known.
    verdict, probability
        ``go``, ``no go`` or ``unsure``, and the probability that d' reaches the threshold; ``no
        go`` and None where the pose is not known.
    dprime
        The d' that the criterion compares with the threshold, an upper bound; None where the pose
        is not known.
    margin
        ``dprime / threshold - 1``: 0.1 is ten per cent above it; None where the pose is not known.
    reason
        Reason for the verdict and what to do, in one line for the operator.
    homography
        Shape (3, 3): frame pixel centres ``(x, y, 1)`` to reference pixel centres, or None.
    zoom
        Reference pixels per frame pixel at the frame's centre, or None.
    overlap
        Share of the frame that the reference covers, or None.
    anchored
        Whether the whole frame was searched for the reference, which takes longer.
    """

    accepted: bool
    verdict: Verdict
    probability: float | None
    dprime: float | None
    margin: float | None
    reason: str
    homography: FloatArray | None
    zoom: float | None
    overlap: float | None
    anchored: bool

    def to_json(self) -> dict[str, object]:
        """Return the verdict for a JSON document."""
        return {
            "is_accepted": self.accepted,
            "verdict": self.verdict,
            "probability": self.probability,
            "dprime_decisive": self.dprime,
            "margin": self.margin,
            "reason": self.reason,
            "zoom": self.zoom,
            "overlap": self.overlap,
            "is_anchored": self.anchored,
            "homography": None if self.homography is None else self.homography.tolist(),
        }


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FollowedPose:
    """Pose of one frame, None where the reference is not recognised; ``reason`` says why not.

    ``anchored``: whether the whole frame was searched for the reference, which takes longer.
    """

    pose: TrackedPose | None
    anchored: bool
    reason: str = ""


class PoseFollower:
    """Follows the camera's pose frame by frame, and finds it again where it was lost.

    Not safe for several threads at once. ``reference``: grey, shape ``(rows, cols)``, any dtype,
    finite.
    """

    def __init__(self, reference: AnyArray) -> None:
        self._reference = TrackingReference(reference)
        self._last: FloatArray | None = None
        self._shape: tuple[int, ...] = ()
        self._is_searching = False

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the reference."""
        return self._reference.shape

    @property
    def is_searching(self) -> bool:
        """Whether ``update`` is searching a whole frame, which takes longer; for other threads."""
        return self._is_searching

    def reset(self) -> None:
        """Forget the pose: the next frame is searched as a whole."""
        self._last = None

    def update(self, image: AnyArray) -> FollowedPose:
        """Find the pose of the next frame: grey, shape ``(rows, cols)``, finite."""
        if image.shape != self._shape:
            self._shape, self._last = image.shape, None
        found = self._followed(image)
        is_anchored = found is None
        if found is None:
            self._is_searching = True
            try:
                found = self._reference.anchored(image)
            except RegistrationError as error:
                self._last = None
                reason = f"the reference is not recognised: {error}"
                return FollowedPose(pose=None, anchored=True, reason=reason)
            finally:
                self._is_searching = False
        self._last = found.matrix
        return FollowedPose(pose=found, anchored=is_anchored)

    def _followed(self, image: AnyArray) -> TrackedPose | None:
        if self._last is None:
            return None
        try:
            return self._reference.followed(image, self._last)
        except RegistrationError:
            return None


class PoseTracker:
    """Follows the camera's pose and judges it, frame by frame.

    Not safe for several threads at once: one tracker belongs to one stream. ``reference``: the
    earlier, nearer image: grey, shape ``(rows, cols)``, any dtype, finite. ``curve``: d' against
    zoom: one curve of a curves.json (``read_curves(path).chosen(...)``). ``criterion``: ``min`` or
    ``quantile``, as in ``pose_quality``.

    Examples
    --------
    >>> tracker = PoseTracker(reference, curve, 2.0)         # doctest: +SKIP
    >>> verdict = tracker.update(camera.next_frame(1.0).image_dn)  # doctest: +SKIP
    >>> verdict.accepted, verdict.margin, verdict.reason     # doctest: +SKIP
    (True, 0.31, 'good: d′ 2.62, threshold 2')
    """

    def __init__(
        self,
        reference: AnyArray,
        curve: DetectabilityCurve,
        min_d_prime: float,
        criterion: Criterion = "min",
    ) -> None:
        if not 0 < min_d_prime < float("inf"):
            raise ValueError(f"min_d_prime must be positive, got {min_d_prime}")
        self._follower = PoseFollower(reference)
        self._curve = curve
        self._min_d_prime = min_d_prime
        self._criterion = criterion
        self._frames = 0
        self._anchors = 0

    @property
    def is_searching(self) -> bool:
        """Whether ``update`` is searching a whole frame, which takes seconds; for other threads."""
        return self._follower.is_searching

    @property
    def frames(self) -> int:
        """Frames seen so far."""
        return self._frames

    @property
    def anchors(self) -> int:
        """How often the whole frame was searched so far."""
        return self._anchors

    def reset(self) -> None:
        """Forget the pose: the next frame is searched as a whole."""
        self._follower.reset()

    def update(self, image: AnyArray) -> PoseVerdict:
        """Judge the pose of the next frame.

        ``image``: grey, shape ``(rows, cols)``, finite; a frame of another size is searched as a
        whole. Where the reference is not recognised the verdict is a rejection with the reason; no
        error is raised then, as an operator on the way loses it all the time.
        """
        self._frames += 1
        found = self._follower.update(image)
        self._anchors += found.anchored
        if found.pose is None:
            return _unknown(found.reason)
        return self._judged(
            found.pose, (image.shape[1], image.shape[0]), is_anchored=found.anchored
        )

    def _judged(
        self, found: TrackedPose, size: tuple[int, int], *, is_anchored: bool
    ) -> PoseVerdict:
        rows, cols = self._follower.shape
        try:
            quality = pose_quality(
                found.matrix, size, (cols, rows), self._curve, self._min_d_prime, self._criterion
            )
        except AnalysisError as error:
            self._follower.reset()
            return _unknown(str(error))
        return PoseVerdict(
            accepted=quality.is_accepted,
            verdict=quality.decision.verdict,
            probability=quality.decision.probability,
            dprime=quality.decisive_d_prime,
            margin=quality.decisive_d_prime / self._min_d_prime - 1,
            reason=_reason(quality, self._curve),
            homography=found.matrix,
            zoom=found.zoom,
            overlap=quality.sampling.overlap,
            anchored=is_anchored,
        )


def _unknown(reason: str) -> PoseVerdict:
    return PoseVerdict(
        accepted=False,
        verdict="no go",
        probability=None,
        dprime=None,
        margin=None,
        reason=reason,
        homography=None,
        zoom=None,
        overlap=None,
        anchored=True,
    )


def _reason(quality: PoseQuality, curve: DetectabilityCurve) -> str:
    """The reason in one line: too far and by how much, or too oblique and where."""
    wanted = f"d′ {quality.decisive_d_prime:.2f}, threshold {quality.min_d_prime:g}"
    if quality.decision.verdict == "unsure":
        return f"unsure: {100 * quality.decision.probability:.0f} % that it is enough ({wanted})"
    if quality.is_accepted:
        return f"good: {wanted}"
    allowed = curve.largest_zoom(quality.min_d_prime)
    if allowed is None:
        return f"no pose is good enough with this curve: {wanted}"
    sampling = quality.sampling
    zoom = np.where(sampling.inside, sampling.worst_zoom, np.nan)
    if float(np.nanmedian(zoom)) > allowed:
        return (
            f"too far: local zoom {np.nanmedian(zoom):.2f}, at most {allowed:.2f} allowed "
            f"({wanted})"
        )
    row, col = np.unravel_index(int(np.nanargmax(zoom)), zoom.shape)
    side = _side(float(row) / (zoom.shape[0] - 1), float(col) / (zoom.shape[1] - 1))
    return (
        f"too oblique: local zoom {np.nanmax(zoom):.2f} {side}, at most {allowed:.2f} allowed "
        f"({wanted})"
    )


def _side(down: float, across: float) -> str:
    """Where in the picture, as an operator says it."""
    across_word = "left" if across < 1 / 3 else "right" if across > 2 / 3 else ""
    down_word = "at the top" if down < 1 / 3 else "at the bottom" if down > 2 / 3 else ""
    if down_word and across_word:
        return f"{down_word} {across_word}"
    return down_word or (f"on the {across_word}" if across_word else "in the middle")


@dataclass(slots=True)
class StreamSummary:
    """Counts of the frames of a stream by verdict, and the verdicts that were kept.

    ``unknown`` frames have no known pose; in ``anchors`` the whole frame was searched for the
    reference. ``followed_s`` is the computing time of all other frames, in s.
    """

    frames: int = 0
    accepted: int = 0
    unknown: int = 0
    anchors: int = 0
    followed_s: float = 0.0
    last: PoseVerdict | None = None
    verdicts: list[dict[str, object]] = field(default_factory=list)

    def add(self, name: str, verdict: PoseVerdict, busy_s: float, *, is_kept: bool) -> None:
        """Count a verdict, and keep it if ``is_kept``."""
        self.frames += 1
        self.accepted += verdict.accepted
        self.unknown += verdict.dprime is None
        self.anchors += verdict.anchored
        if not verdict.anchored:
            self.followed_s += busy_s
        self.last = verdict
        if is_kept:
            self.verdicts.append({"frame": name, **verdict.to_json()})

    @property
    def frames_per_s(self) -> float | None:
        """Frames per second of computing time, without anchors; None if all were anchors."""
        followed = self.frames - self.anchors
        return followed / self.followed_s if followed else None
