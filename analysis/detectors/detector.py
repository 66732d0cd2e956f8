"""What a detector of changes is, and what it answers."""

from dataclasses import dataclass, field
from typing import Protocol

from simulation.arrays import Float32Array, FloatArray


class Detector(Protocol):
    """Says how much changed between two photographs.

    Any function with these arguments is one. The arrays are its own: it may write into them. One
    with an attribute ``colour = True`` is given colours, see `takes_colour`.
    """

    def __call__(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray, /
    ) -> float | Float32Array:
        """Compare a follow-up with its reference.

        Parameters
        ----------
        reference, followup
            Shape ``(rows, cols)`` each, or ``(rows, cols, 3)`` if it takes colours; rows and cols
            may differ. Levels linear in light.
        homography
            Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.

        Returns
        -------
        float or array
            How changed the pair is; or how changed each pixel of the follow-up is, of shape
            ``(rows, cols)``.
            Higher is more changed; the scale is the detector's own.
        """
        ...


def takes_colour(detector: Detector) -> bool:
    """Whether a detector has an attribute ``colour`` that is True.

    Then both of its photographs have shape ``(rows, cols, 3)``: red, green and blue, three times
    the same plane of a grey one. Any other detector is given grey levels, of colours their luma.
    """
    return getattr(detector, "colour", False) is True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DetectorAnswer:
    """What a detector says of one pair.

    Parameters
    ----------
    score
        How changed the pair is: the detector's number, or the largest value of its map among the
        pixels that see the reference.
    map
        How changed each pixel of the follow-up is, finite; where a pixel does not see the
        reference, the least value among those that do. None if the detector gives a number.
    """

    score: float
    map: Float32Array | None = field(default=None, repr=False)
