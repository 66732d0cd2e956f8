"""What makes changes doubtful, in sentences."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from analysis.changes.document import Change
from simulation.arrays import BoolArray

_STRIP_PX: Final = 8
"""Depth along the border of what was compared within which changes make a strip."""

_STRIP_SHARE: Final = 0.5
_STRIP_LENGTH: Final = 0.15
"""Share of the side of the frame along which a strip's changes lie: a blob at the border has
less."""

_LEAST_STRIP_PX: Final = 30

_GLOSS_REACH_PX: Final = 10
"""Distance from a clipped pixel: its glare around it, the mask's own margin included."""

_MOST_GLOSS_SHARE: Final = 0.01
"""Share of the frame of a highlight; what is larger is no gloss but a wrong exposure."""

_LEAST_GLOSS_PX: Final = 4
_LEAST_OVERLAP: Final = 1 / 3
_SIDES: Final = ("top", "left", "bottom", "right")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeMasks:
    """Masks on the follow-up's pixels, shape ``(rows, cols)`` each.

    Parameters
    ----------
    is_change
        Pixels beyond the threshold.
    valid
        Pixels that were compared.
    clipped
        Pixels at which the follow-up is clipped at white.
    reference_clipped
        Pixels at which the reference is, as the follow-up would see it.
    """

    is_change: BoolArray
    valid: BoolArray
    clipped: BoolArray
    reference_clipped: BoolArray


def change_warnings(changes: Sequence[Change], masks: ChangeMasks) -> tuple[str, ...]:
    """Return a sentence each for flagged borders, likely gloss and a small overlap."""
    said = (_strips(masks), _gloss(changes, masks), _overlap(masks))
    return tuple(sentence for sentence in said if sentence)


def _strips(masks: ChangeMasks) -> str:
    """Changes along the border of the overlap, whose side is told."""
    flagged = masks.is_change
    if np.count_nonzero(flagged) < _LEAST_STRIP_PX:
        return ""
    # Holes that are masked inside the overlap are no border of it.
    seen = _without_holes(masks.valid)
    depth = cv2.distanceTransform(np.pad(seen, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    strip = flagged & (depth <= _STRIP_PX)
    count = int(np.count_nonzero(strip))
    if count < max(_LEAST_STRIP_PX, _STRIP_SHARE * np.count_nonzero(flagged)):
        return ""
    rows, cols = np.nonzero(seen)
    ends = rows.min(), cols.min(), rows.max(), cols.max()
    y, x = np.nonzero(strip)
    distance = np.abs([y - ends[0], x - ends[1], y - ends[2], x - ends[3]])
    side_of = np.argmin(distance, axis=0)
    lined = []
    for index, side in enumerate(_SIDES):
        along = (x if index % 2 == 0 else y)[side_of == index]
        length = flagged.shape[1 if index % 2 == 0 else 0]
        if len(np.unique(along)) > _STRIP_LENGTH * length:
            lined.append(side)
    if not lined:
        return ""
    return (
        f"{count} of {np.count_nonzero(flagged)} changed pixels line the {' and '.join(lined)} of "
        "what both photographs show: a mount, a shadow or the lens may differ there; leave the "
        "border out with --mask to see the rest"
    )


def _without_holes(mask: BoolArray) -> BoolArray:
    outside = np.pad((~mask).astype(np.uint8), 1, constant_values=1)
    cv2.floodFill(outside, None, (0, 0), 2)
    return np.asarray(outside[1:-1, 1:-1] != 2)


def _gloss(changes: Sequence[Change], masks: ChangeMasks) -> str:
    """Compact highlights that only one photograph shows clipped, and bright changes around one."""
    single = []
    for name, own, other in (
        ("follow-up", masks.clipped, masks.reference_clipped),
        ("reference", masks.reference_clipped, masks.clipped),
    ):
        blobs = _compact_blobs(own, _within(other, _GLOSS_REACH_PX))
        if blobs:
            single.append(f"{blobs} in the {name} alone")
    rims = _rims(changes, masks)
    if not single and not rims:
        return ""
    found = ""
    if single:
        found = f"clipped highlights: {', '.join(single)}"
    if rims:
        beside = f"{rims} of {len(changes)} changes lie beside clipped pixels"
        found = f"{found}; {beside}" if found else beside
    return f"{found}: likely gloss, which moves with the light and the camera"


def _compact_blobs(clipped: BoolArray, beside_other: BoolArray) -> int:
    if not clipped.any():
        return 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats(clipped.astype(np.uint8))
    area = stats[:, cv2.CC_STAT_AREA]
    is_compact = (area >= _LEAST_GLOSS_PX) & (area <= _MOST_GLOSS_SHARE * clipped.size)
    is_compact[0] = False
    is_compact[np.unique(labels[beside_other])] = False
    return int(np.count_nonzero(is_compact[:count]))


def _rims(changes: Sequence[Change], masks: ChangeMasks) -> int:
    """Changes beside pixels that one photograph alone shows clipped, of the highlight's sign."""
    brighter, darker = (
        _within(own & ~_within(other, _GLOSS_REACH_PX), _GLOSS_REACH_PX)
        for own, other in (
            (masks.clipped, masks.reference_clipped),
            (masks.reference_clipped, masks.clipped),
        )
    )
    count = 0
    for change in changes:
        row, col = (
            min(max(round(at), 0), most - 1)
            for at, most in zip((change.y_px, change.x_px), brighter.shape, strict=True)
        )
        count += bool((brighter if change.amplitude_dn > 0 else darker)[row, col])
    return count


def _within(mask: BoolArray, reach_px: int) -> BoolArray:
    """Pixels so near to one of the mask."""
    if not mask.any():
        return np.zeros_like(mask)
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(distance <= reach_px)


def _overlap(masks: ChangeMasks) -> str:
    share = float(np.mean(masks.valid))
    if share >= _LEAST_OVERLAP:
        return ""
    return (
        f"only {100 * share:.0f} % of the follow-up were compared: look at compared.png whether "
        "this is what both photographs show"
    )
