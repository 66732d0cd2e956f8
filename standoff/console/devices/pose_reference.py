"""Makes the tracker that follows the pose against a reference."""

from typing import Any

from analysis.detectability import DetectabilityCurve
from analysis.pose import PoseTracker
from simulation.arrays import AnyArray
from standoff.console.devices.pose_monitor import TrackerMaker


def tracker_maker(curve: DetectabilityCurve, min_dprime: float) -> TrackerMaker:
    """Return what makes a tracker of a reference image, judged by this curve."""

    def make(image: AnyArray) -> PoseTracker:
        reference: Any = image
        return PoseTracker(reference, curve, min_dprime)

    return make
