"""Pixels at the ends of a photograph's levels, and pages of print, which have few others."""

from typing import Final

import cv2
import numpy as np

from analysis.changes.matching import smoothed
from simulation.arrays import AnyArray, BoolArray, FloatImage

_LEAST_CLIPPED_SHARE: Final = 1e-4
"""Share of the frame at one end of the levels; fewer are noise, or a defect of a pixel or two."""

_WHITE_DN: Final = 0.5
_WHITE_RATIO: Final = 0.002
"""Clipped levels may be this far below white; less where white is 1."""

_LEVELS_BELOW: Final = 4
_ABOVE_CHANCE: Final = 3.0
"""A plateau holds more pixels than any of the four next levels, by this factor: levels thin out
towards their end unless they are cut off there. Noise of 1.2 levels on a ramp into white piles up
5 times as many."""


_CLUSTER_PX: Final = 3
"""Pixels of a 3 x 3 neighbourhood at an end of the file's levels: light that reached it. Two may be
noise; fewer than a plateau's share of the frame, they still hold a false change of 12 px."""

_FULL_SCALES: Final = (1.0, *(2.0**bits - 1 for bits in (8, 10, 12, 14, 16)))

_LEAST_OF_A_LEVEL, _MOST_OF_TWO_LEVELS = 0.01, 0.9
"""Share of the pixels at black and at white, each and both, from which on a picture counts as a
drawing of these two levels."""

_BLACK, _WHITE = 0.01, 0.93
"""Up to and from where a level is near one of them, over their range: sRGB codes 25 and 247, to
which JPEG files of drawings keep."""

_LEAST_WHITE, _LEAST_EXACT = 0.1, 0.7
"""Share of the pixels near white, and share exactly at either level: of a night with lamps most
pixels are near black, too."""

_AROUND_PX, _MOSTLY = 2.0, 0.8
"""Share of the pixels around one, by a Gaussian, from which on a channel is at an end of its scale
there. Half of them are where noise about that end is cut off, and this is seen in both."""

Ends = tuple[BoolArray, BoolArray]
"""Pixels at black, and at white."""


def unusable(image_dn: FloatImage, white_level_dn: float | None) -> BoolArray:
    """Mark pixels that are clipped, at either end.

    ``image_dn``: shape ``(rows, cols)``. ``white_level_dn``: level at which the photograph is
    clipped, if it is known; a plateau counts anyway.
    """
    return clipped_at_white(image_dn, white_level_dn) | clipped_at_black(image_dn)


def clipped_at_black(image_dn: FloatImage) -> BoolArray:
    """Mark pixels on a plateau at the lowest level, or at 0.

    Of those whose light is missing no more than noise where they are single, only the ones amid
    others.
    """
    lost: BoolArray = np.zeros(image_dn.shape, dtype=np.bool_)
    if image_dn.min() == 0:
        lost |= _clusters(np.asarray(image_dn == 0))
    black = _plateau(-image_dn)
    if black.any():
        around = cv2.blur(black.astype(np.float32), (3, 3), borderType=cv2.BORDER_REFLECT_101)
        lost |= black & (around > 0.5)
    return lost


def clipped_at_white(image_dn: FloatImage, white_level_dn: float | None) -> BoolArray:
    """Mark pixels at the white level, or on a plateau at the highest."""
    lost = _plateau(image_dn)
    highest = float(image_dn.max())
    if highest in _FULL_SCALES:
        lost |= _clusters(np.asarray(image_dn == highest))
    if white_level_dn is not None:
        below = min(_WHITE_DN, _WHITE_RATIO * abs(white_level_dn))
        at_white = image_dn >= white_level_dn - below
        if np.count_nonzero(at_white) > _LEAST_CLIPPED_SHARE * image_dn.size:
            lost |= at_white
    return lost


def _clusters(at_end: BoolArray) -> BoolArray:
    """Pixels of a mask that are next to others of it."""
    if not at_end.any():
        return at_end
    count = cv2.boxFilter(
        at_end.astype(np.uint8), cv2.CV_8U, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(at_end & (count >= _CLUSTER_PX))


def _plateau(image_dn: FloatImage) -> BoolArray:
    """Pixels at exactly the highest level, if they are far too many for the end of a tail."""
    highest = image_dn.max()
    at_top: BoolArray = np.asarray(image_dn == highest)
    count = np.count_nonzero(at_top)
    if not _LEAST_CLIPPED_SHARE * image_dn.size < count < image_dn.size:
        return np.zeros_like(at_top)
    below = image_dn[~at_top]
    for _ in range(_LEVELS_BELOW):
        is_next = below == below.max()
        if count < _ABOVE_CHANCE * np.count_nonzero(is_next):
            return np.zeros_like(at_top)
        below = below[~is_next]
        if not below.size:
            break
    return at_top


def is_of_two_levels(image_dn: AnyArray) -> bool:
    """Whether a photograph is a drawing of two levels, as a page of print is, which is flat.

    Most of it is at black or white then, and some at either.
    """
    levels = np.nan_to_num(np.asarray(image_dn, dtype=np.float32), posinf=0.0, neginf=0.0)
    low_dn, high_dn = levels.min(), levels.max()
    black_dn, white_dn = (low_dn + at * (high_dn - low_dn) for at in (_BLACK, _WHITE))
    near = float(np.mean(levels <= black_dn)), float(np.mean(levels >= white_dn))
    if not high_dn > low_dn or sum(near) < _MOST_OF_TWO_LEVELS:
        return False
    exact = float(np.mean(levels == low_dn) + np.mean(levels == high_dn))
    if near[0] >= _LEAST_OF_A_LEVEL and near[1] >= _LEAST_WHITE and exact >= _LEAST_EXACT:
        return True
    black, white = clipped_at_black(levels), clipped_at_white(levels, None)
    least = min(float(np.mean(black)), float(np.mean(white)))
    return least >= _LEAST_OF_A_LEVEL and float(np.mean(black | white)) >= _MOST_OF_TWO_LEVELS


def mostly(mask: BoolArray) -> BoolArray:
    """Pixels of a mask amid others of it."""
    if not mask.any():
        return mask
    return np.asarray(mask & (smoothed(mask.astype(np.float32), _AROUND_PX) > _MOSTLY))
