"""What the depth of a scene costs a follow-up from this pose, and which pose would show less."""

from dataclasses import dataclass
from math import hypot, tan
from typing import Literal

import numpy as np

from analysis.changes import ParallaxMap, SceneParallax
from analysis.results_file import StoredValues
from calibration.parallax import likely_viewpoint
from calibration.registration import DistortedPose
from simulation.arrays import BoolArray, FloatArray
from simulation.by_value import ByValue

_ENDS = (2.5, 97.5)
_LESS = 0.8
"""Of the parallax, what may be left for a move to be worth a word."""

_ASIDE = tan(np.pi / 8)
"""Slope from which a direction is named by both of its components."""


class PoseParallax(StoredValues):
    """Parallax of a scene with depth, seen from a pose.

    Parameters
    ----------
    low_px, high_px
        Parallax in follow-up pixels, towards the epipole, that 2.5 and 97.5 % of the pixels do not
        exceed.
    range_px
        What lies between: 95 % of the pixels.
    in_line_range_px
        The same, if the camera were moved sideways until the reference's camera lay on its optical
        axis, at the same distance from the scene.
    hidden
        Share of the overlap that one of the photographs hides, or whose depth is not known; no
        change would be found there.
    place_err_px
        Median standard error of the places that follow from the parallax, in reference pixels.
    larger_is
        Whether what has the larger parallax is nearer to the camera or farther away; None if the
        two photographs do not tell.
    move
        Direction in which the camera would have to be moved for that, ``(x, y)`` of length 1: right
        and down in the follow-up; None if the two photographs do not tell.
    """

    low_px: float
    high_px: float
    range_px: float
    in_line_range_px: float
    hidden: float
    place_err_px: float
    larger_is: Literal["nearer", "farther"] | None = None
    move: tuple[float, float] | None = None

    @property
    def sentence(self) -> str:
        """What the parallax costs, and which pose would show less."""
        said = (
            f"the scene has depth: parallax spreads 95 % of it over {self.range_px:.1f} px, and "
            f"{100 * self.hidden:.0f} % of the overlap is hidden in one of the photographs or of "
            "unknown depth, where no d' was judged"
        )
        if self.in_line_range_px > _LESS * self.range_px:
            return (
                f"{said}; it comes from the difference in distance, and moving sideways would not "
                "reduce it much"
            )
        where = "sideways" if self.move is None else f"to the {_words(self.move)}"
        return (
            f"{said}; with the camera moved {where}, in line with where the reference was taken "
            f"and at the same distance, {self.in_line_range_px:.1f} px would be left"
        )

    @property
    def short_sentence(self) -> str:
        """The same for the title of a picture."""
        return (
            f"parallax of 95 %: {self.range_px:.1f} px; hidden or unknown: {100 * self.hidden:.0f} "
            "% of the overlap"
        )


def _words(move: tuple[float, float]) -> str:
    """A direction in the picture, as an operator says it."""
    x, y = move
    across, down = "right" if x > 0 else "left", "bottom" if y > 0 else "top"
    if abs(y) < _ASIDE * abs(x):
        return across
    return down if abs(x) < _ASIDE * abs(y) else f"{down} {across}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ParallaxCost(ByValue):
    """Figures of a parallax, and follow-up pixels that are hidden in one of the photographs."""

    figures: PoseParallax
    is_hidden: BoolArray


def parallax_cost(pose: DistortedPose, seen: ParallaxMap, found: SceneParallax) -> ParallaxCost:
    """What the parallax costs that a comparison found.

    ``pose``: with that parallax. ``seen``: on the follow-up's pixels, known somewhere.
    """
    epipole = np.array(found.epipole)
    rows, cols = pose.followup_shape
    middle_x, middle_y = (cols - 1) / 2, (rows - 1) / 2
    is_known = np.isfinite(seen.parallax_px)
    parallax = seen.parallax_px[is_known].astype(np.float64)
    y, x = (at.astype(np.float64) for at in np.nonzero(is_known))
    # What displaces a pixel is in proportion to epipole - w pixel, of which the part to the middle
    # of the frame is the same for all: that of the step aside.
    reach = np.hypot(epipole[0] - epipole[2] * x, epipole[1] - epipole[2] * y)
    forward = epipole[2] * np.hypot(middle_x - x, middle_y - y)
    low, high = np.percentile(parallax, _ENDS).tolist()
    left = np.percentile(parallax * forward / np.maximum(reach, 1e-12), _ENDS)
    shown = np.count_nonzero(is_known) + np.count_nonzero(seen.is_hidden)
    figures = PoseParallax(
        low_px=low,
        high_px=high,
        range_px=high - low,
        in_line_range_px=float(np.ptp(left)),
        hidden=np.count_nonzero(seen.is_hidden) / shown,
        place_err_px=_place_err_px(pose),
        larger_is=found.larger_is,
        move=_move(pose, epipole),
    )
    return ParallaxCost(figures=figures, is_hidden=seen.is_hidden)


def _place_err_px(pose: DistortedPose) -> float:
    """Error of the places, in reference pixels, where both photographs show the same."""
    depth = pose.parallax
    assert depth is not None, "a pose with parallax"
    error = depth.error_px[depth.is_seen & np.isfinite(depth.error_px)]
    if not error.size:
        return 0.0
    scale = pose.plane.zoom if depth.photograph == "followup" else 1.0
    return scale * float(np.median(error))


def _move(pose: DistortedPose, epipole: FloatArray) -> tuple[float, float] | None:
    """Direction in the follow-up towards the line on which the reference was taken."""
    if pose.reference_shape != pose.followup_shape:
        return None
    viewpoint = likely_viewpoint(pose.matrix, epipole, pose.followup_shape)
    if viewpoint is None:
        return None
    x, y, _ = viewpoint.centre.tolist()
    length = hypot(x, y)
    return (x / length, y / length) if length > 0 else None
