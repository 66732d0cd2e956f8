"""Pixels whose level says little of the light: clipped at white, or at black."""

from simulation.arrays import BoolArray, FloatArray


def unusable(image_dn: FloatArray, white_level_dn: float | None) -> BoolArray:
    """Mark pixels that are clipped: at the white level, or on a plateau at either end.

    They are to be dilated by the reach of whatever is computed from them.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    white_level_dn
        Level at which the photograph is clipped, if it is known; a plateau counts anyway.
    """
    raise NotImplementedError
