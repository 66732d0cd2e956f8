"""Images of a comparison on the follow-up's pixels."""

from dataclasses import dataclass

import numpy as np

from analysis.changes.comparison import Comparison
from analysis.changes.matching import PixelPositions, spline_coefficients
from calibration.registration import DistortedPose
from simulation.arrays import BoolArray, FloatImage


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FollowupGrid:
    """Brings images of a comparison to the follow-up's pixels.

    Parameters
    ----------
    positions
        Of the follow-up's pixels on the comparison's grid; None if they are the same.
    valid
        Follow-up pixels that were compared.
    followup_px
        Follow-up pixels to one of the grid, along a line.
    """

    positions: PixelPositions | None
    valid: BoolArray
    followup_px: float

    @classmethod
    def of(cls, compared: Comparison, pose: DistortedPose) -> "FollowupGrid":
        """Find where the pixels of both lie."""
        if compared.is_on_followup:
            return cls(positions=None, valid=compared.valid, followup_px=1.0)
        positions = PixelPositions.of(
            pose.to_reference_px, pose.followup_shape, pose.reference_shape
        )
        valid = positions.inside(compared.valid, 0.0)
        return cls(positions=positions, valid=valid, followup_px=1 / positions.zoom)

    def brought(self, image: FloatImage, outside: float = 0.0) -> FloatImage:
        """Interpolate a smooth image; ``outside`` where it was not compared."""
        if self.positions is None:
            return np.where(self.valid, image, np.float32(outside))
        known = np.isfinite(image)
        # What is not known must not ring into what is.
        whole = np.where(known, image, np.float32(np.median(image[known])) if known.any() else 0)
        coefficients = spline_coefficients(np.asarray(whole, dtype=np.float32), 0.0)
        seen = self.positions.seen(coefficients)
        return np.where(self.valid & np.isfinite(seen), seen, np.float32(outside))

    def marked(self, mask: BoolArray) -> BoolArray:
        """Bring a mask."""
        return mask if self.positions is None else self.positions.inside(mask, 0.0)
