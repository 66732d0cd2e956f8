"""What is said of a frame or a still: go, no go or unsure, why, and what would make it better."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from analysis.detectability import DetectabilityCurve
from analysis.errors import AnalysisError
from analysis.pose import (
    Arrow,
    FrameFaults,
    PoseDeviation,
    PoseQuality,
    Verdict,
    frame_faults,
    pose_deviation,
    pose_quality,
)
from simulation.arrays import FloatArray
from simulation.pose import project
from standoff.console.guide._own_psf import FrameCurve
from standoff.console.guide._reference import GuideReference, scaled_matrix

ByteImage = NDArray[np.uint8]

GO_UP_TO: Final = 0.8
"""Share of a tolerance up to which a pose is good: a hand moves on while it presses the shutter."""

UNSURE_UP_TO: Final = 2.0
"""Multiples of a tolerance up to which a pose is unsure."""

MOST_MOTION: Final = 0.5
"""Speed of the picture, in frames a second, from which blur is taken for that of motion."""

WITHOUT_CURVES: Final = (
    "No curves are given, so the pose is judged by where the camera stands: the same distance "
    "within 3 %, the same direction within 2°, the same middle within 2 % of the picture; and by "
    "d′, once this phone's own pictures have told how sharp its camera is."
)

STEADY: Final = 0.06
"""Speed of the picture, in frames a second, up to which a hand is steady enough for the shutter."""

_RANK: Final[dict[Verdict, int]] = {"go": 0, "unsure": 1, "no go": 2}
_REMEDIES: Final = {
    "light": "more light",
    "glare": "keep the reflection of the lamp out of the picture",
    "focus": "tap the scene on the phone to focus, or wipe the lens",
    "motion": "hold still",
}
_COSTS: Final = {
    "distance": "the distance",
    "aim": "where it is aimed",
    "turn": "the turn",
    "tilt": "the tilt",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """What is said of one picture.

    Parameters
    ----------
    verdict
        Go, no go or unsure; no go where the scene is not recognised.
    words
        The reason in a sentence.
    remedy
        What would make it better, in a sentence; empty if nothing would.
    faults
        The remedies of what is wrong besides where the camera stands, such as too little light.
    arrows
        Movements to make, at most two, the most urgent first.
    outline
        Corners of the reference in the picture, ``(x, y)`` in shares of its width and height;
        empty where it is not recognised.
    deviation, quality
        Where the camera stands, and the verdict by curves, where known.
    judged_by
        What d' is of and by which PSF, if no curves were given; empty where d' is not known.
    wants_fine
        Whether a frame that is hardly compressed would tell more of the camera.
    """

    verdict: Verdict
    words: str
    remedy: str = ""
    faults: tuple[str, ...] = ()
    arrows: tuple[Arrow, ...] = ()
    outline: tuple[tuple[float, float], ...] = ()
    deviation: PoseDeviation | None = field(default=None, repr=False)
    quality: PoseQuality | None = field(default=None, repr=False)
    judged_by: str = ""
    wants_fine: bool = False

    @property
    def spoken(self) -> str:
        """What to do next, for a voice: arrows come first until the camera stands where it did."""
        is_placed = self.deviation is not None and self.deviation.largest_cost <= GO_UP_TO
        if self.faults and (is_placed or not self.arrows):
            return ", ".join(self.faults)
        return self.arrows[0].words if self.arrows else self.words

    def to_json(self) -> dict[str, object]:
        """Return what the page shows, and the figures behind it."""
        deviation, quality = self.deviation, self.quality
        return {
            "verdict": self.verdict,
            "words": self.words,
            "remedy": self.remedy,
            "faults": self.faults,
            "spoken": self.spoken,
            "arrows": [{"name": one.name, "words": one.words} for one in self.arrows],
            "outline": self.outline,
            "pose": None
            if deviation is None
            else {name: getattr(deviation, name) for name in PoseDeviation.__dataclass_fields__},
            "dprime": None if quality is None else quality.decisive_d_prime,
            "dprime_lost": None if quality is None else dprime_lost(quality),
            "judged_by": self.judged_by,
            "wants_fine": self.wants_fine,
        }


class Judge:
    """Judges pictures against a reference: by the pose, and by d' where that is known.

    It is known by a given ``curve``, else by that of the phone's own frames, once there is one.
    """

    def __init__(
        self,
        reference: GuideReference,
        curve: DetectabilityCurve | None = None,
        min_d_prime: float = 2.0,
        of_frames: FrameCurve | None = None,
    ) -> None:
        self.reference = reference
        self._curve = curve
        self._min_d_prime = min_d_prime
        self._of_frames = of_frames

    def by_frames(self, found: FrameCurve | None) -> "Judge":
        """Return a judge by what one phone's own frames tell, unless a curve was given."""
        if found is None or self._curve is not None:
            return self
        return Judge(self.reference, None, self._min_d_prime, found)

    def use(self, curve: DetectabilityCurve | None, min_d_prime: float) -> None:
        """Judge by this curve from now on."""
        self._curve, self._min_d_prime = curve, min_d_prime

    @property
    def has_curve(self) -> bool:
        """Whether poses are judged by a given curve."""
        return self._curve is not None

    def lost(self) -> Assessment:
        """Say that the scene is not recognised."""
        return Assessment(
            verdict="no go",
            words="The scene of the reference is not recognised.",
            remedy="Show as much of it as the reference does, in good light.",
        )

    def judged(
        self,
        levels: ByteImage,
        matrix: FloatArray,
        *,
        full_size: tuple[int, int] | None = None,
        motion: float | None = 0.0,
        level: float | None = None,
    ) -> Assessment:
        """Judge a picture whose pose was found.

        Parameters
        ----------
        levels
            Grey levels as displayed, shape ``(rows, cols)``.
        matrix
            Shape (3, 3): its pixel centres to those of ``reference.levels``.
        full_size
            ``(width, height)`` of the still that is judged; by default it is taken to be sampled
            as finely as the reference.
        motion
            Speed of the picture, in frames a second; where it is None, not known, nothing is good.
        level
            Mean level as displayed, from 0 to 1; by default that of ``levels``.
        """
        rows, cols = levels.shape
        size, small = (cols, rows), self.reference.small_size
        try:
            deviation = pose_deviation(matrix, size, small)
        except (ValueError, np.linalg.LinAlgError):
            return self.lost()
        faults = frame_faults(levels, self.reference.levels, matrix)
        if faults is not None and not faults.is_same_scene:
            return self.lost()
        if faults is not None and level is not None:
            faults = replace(faults, level=level)
        quality = self._quality(matrix, size, full_size)
        verdict, causes = self._verdict(deviation, faults, quality, motion)
        arrows = deviation.arrows()
        remedies = [
            _REMEDIES[each] for each, value in causes.items() if each in _REMEDIES and value > 1
        ]
        if verdict != "go" and not is_steady(motion) and deviation.largest_cost <= GO_UP_TO:
            remedies.insert(0, _REMEDIES["motion"])
        told = ", then ".join(arrow.words for arrow in arrows) if verdict != "go" else ""
        return Assessment(
            verdict=verdict,
            words=_said(verdict, deviation, causes, quality),
            remedy="; ".join(filter(None, (told, *remedies))),
            faults=tuple(dict.fromkeys(remedies)),
            arrows=arrows,
            outline=_outline(matrix, size, small),
            deviation=deviation,
            quality=quality,
            judged_by="" if quality is None or self._of_frames is None else self._of_frames.words,
        )

    def _verdict(
        self,
        deviation: PoseDeviation,
        faults: FrameFaults | None,
        quality: PoseQuality | None,
        motion: float | None,
    ) -> tuple[Verdict, dict[str, float]]:
        """The verdict, and all costs by name, largest first."""
        causes: dict[str, float] = {str(name): cost for name, cost in deviation.costs.items()}
        if faults is None:
            causes["aim"] = max(causes["aim"], 2 * UNSURE_UP_TO)
        else:
            others = faults.costs()
            blur = "motion" if (motion or 0.0) > MOST_MOTION else "focus"
            causes |= {
                blur: others["sharpness"],
                "light": others["light"],
                "glare": others["glare"],
            }
        largest = max(causes.values())
        is_good = deviation.largest_cost <= GO_UP_TO and largest <= 1 and is_steady(motion)
        verdict: Verdict = "go" if is_good else "unsure"
        if largest > UNSURE_UP_TO:
            verdict = "no go"
        if quality is not None and _RANK[quality.decision.verdict] > _RANK[verdict]:
            verdict = quality.decision.verdict
        return verdict, dict(sorted(causes.items(), key=lambda one: -one[1]))

    def _quality(
        self, matrix: FloatArray, size: tuple[int, int], full_size: tuple[int, int] | None
    ) -> PoseQuality | None:
        reference = self.reference
        if self._of_frames is not None:
            return self._of_frames.quality(matrix, size, reference.small_size, self._min_d_prime)
        if self._curve is None:
            return None
        if full_size is None:
            factor = max(reference.size) / max(size)
            full_size = round(size[0] * factor), round(size[1] * factor)
        full = scaled_matrix(matrix, (size, reference.small_size), (full_size, reference.size))
        try:
            return pose_quality(full, full_size, reference.size, self._curve, self._min_d_prime)
        except AnalysisError:
            return None


def is_steady(motion: float | None) -> bool:
    """Whether a hand is steady enough for the shutter."""
    return motion is not None and motion <= STEADY


def dprime_lost(quality: PoseQuality) -> float | None:
    """Share of d' that is lost against the reference's own pose; None where that is not known."""
    best = float(np.asarray(quality.curve.d_prime_at(np.array([1.0])))[0])
    return max(1 - quality.decisive_d_prime / best, 0.0) if best > 0 else None


def _said(
    verdict: Verdict,
    deviation: PoseDeviation,
    causes: dict[str, float],
    quality: PoseQuality | None,
) -> str:
    """The reason."""
    name, cost = next(iter(causes.items()))
    worst = _COSTS.get(name, {"motion": "motion blur"}.get(name, name))
    words = f"{deviation.sentence[0].upper()}{deviation.sentence[1:]}."
    if quality is not None:
        lost = dprime_lost(quality)
        share = "" if lost is None else f"; {100 * lost:.0f} % is lost against the reference's pose"
        words += f" d′ {quality.decisive_d_prime:.2f} of at least {quality.min_d_prime:g}{share}."
    if verdict != "go" and cost > GO_UP_TO:
        words += f" What costs most: {worst}."
    return words


def _outline(
    matrix: FloatArray, size: tuple[int, int], reference_size: tuple[int, int]
) -> tuple[tuple[float, float], ...]:
    width, height = reference_size
    x, y = project(
        np.asarray(np.linalg.inv(matrix), dtype=np.float64),
        np.array([-0.5, width - 0.5, width - 0.5, -0.5]),
        np.array([-0.5, -0.5, height - 0.5, height - 0.5]),
    )
    return tuple(
        (float((one + 0.5) / size[0]), float((other + 0.5) / size[1]))
        for one, other in zip(x, y, strict=True)
    )
