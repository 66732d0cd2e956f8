"""The list of changes: connected pixels beyond the threshold, each with place and amplitude."""

from typing import Protocol

from analysis.changes.document import Change
from calibration.registration import DistortedPose
from simulation.arrays import BoolArray, FloatArray


class ComparedGrid(Protocol):
    """What the list needs to know of two photographs that were compared, shape of the grid each."""

    @property
    def is_on_followup(self) -> bool:
        """Whether the grid is that of the follow-up's pixels; the reference's if not."""
        ...

    @property
    def difference_dn(self) -> FloatArray:
        """After minus before, smoothed."""
        ...

    @property
    def sd_dn(self) -> FloatArray:
        """Standard deviation of the smoothed difference."""
        ...

    @property
    def valid(self) -> BoolArray:
        """Pixels that were compared."""
        ...

    @property
    def smoothing_px(self) -> float:
        """Width of the Gaussian that smoothed the difference, in pixels of the grid."""
        ...


def list_changes(
    compared: ComparedGrid, pose: DistortedPose, threshold_sd: float
) -> tuple[Change, ...]:
    """List the connected changes of one sign, the most significant first.

    Parameters
    ----------
    compared
        The smoothed difference with its standard deviation.
    pose
        Of the follow-up in the reference: gives the places in the photograph that is not the grid.
    threshold_sd
        Standard deviations beyond which a pixel counts as changed.
    """
    raise NotImplementedError
