"""How much of the detail in a picture is not of one edge that crosses it.

An edge across the picture looks the same from every height; a texture is drawn at another scale,
and its focus value changes with that as it does with the focus.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.focus.measures import Levels

_BLOCK_PX = 8
_FEWEST_BLOCKS = 4
_CORE = 0.25  # of the strongest block: those that say where the edge is
_BAND = 0.125  # of the shorter side, to either side of the edge
_CROSSED = 0.85  # of the way across the picture


def texture_share(image_dn: Levels) -> float:
    """Share of the detail that does not lie along one straight edge across the picture.

    Detail is what differs more over two pixels than over one: noise and the sensor's own pattern,
    which differ from pixel to pixel, are none.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.

    Returns
    -------
    float
        From 0, an edge alone, to 1, a texture; 1 also where there is no detail, and for less than
        32 px either way.
    """
    detail = _detail_blocks(np.asarray(image_dn, dtype=np.float32))
    if min(detail.shape) < _FEWEST_BLOCKS or not detail.sum() > 0:
        return 1.0
    y, x = np.nonzero(detail > _CORE * detail.max())
    weight = detail[y, x]
    centre = np.average([x, y], axis=1, weights=weight)
    spread = np.cov([x, y], aweights=weight) if x.size > 1 else np.eye(2)
    normal, along = np.linalg.eigh(spread)[1].T
    rows, cols = np.indices(detail.shape)
    away = normal[0] * (cols - centre[0]) + normal[1] * (rows - centre[1])
    on_line = np.abs(away) <= 1.0
    position = along[0] * (cols - centre[0]) + along[1] * (rows - centre[1])
    is_drawn = on_line & (detail > _CORE * np.median(detail[on_line]))
    crossed = np.ptp(position[is_drawn]) if is_drawn.any() else 0.0
    if crossed < _CROSSED * np.ptp(position[on_line]):
        return 1.0
    beside = np.abs(away) > max(_BAND * min(detail.shape), 1.0)
    # As much detail lies in the band as in any other place.
    share = detail[beside].sum() / detail.sum() / max(float(beside.mean()), 1e-9)
    return float(np.clip(share, 0.0, 1.0))


def _detail_blocks(levels_dn: NDArray[np.float32]) -> NDArray[np.float64]:
    """Squared differences over two pixels less those over one, summed in blocks."""
    inner = levels_dn[:-2, :-2]
    detail = (levels_dn[:-2, 2:] - inner) ** 2 + (levels_dn[2:, :-2] - inner) ** 2
    detail -= (levels_dn[:-2, 1:-1] - inner) ** 2 + (levels_dn[1:-1, :-2] - inner) ** 2
    rows, cols = (length // _BLOCK_PX for length in detail.shape)
    cut = detail[: rows * _BLOCK_PX, : cols * _BLOCK_PX].astype(np.float64)
    return np.asarray(cut.reshape(rows, _BLOCK_PX, cols, _BLOCK_PX).sum(axis=(1, 3)))
