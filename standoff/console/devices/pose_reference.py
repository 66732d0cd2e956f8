"""Makes the tracker of the pose relative to a reference."""

from typing import Any

from analysis.detectability import DetectabilityCurve
from analysis.pose import PoseTracker
from simulation.arrays import AnyArray
from standoff.console.devices.pose_monitor import TrackerMaker


def tracker_maker(curve: DetectabilityCurve, min_dprime: float) -> TrackerMaker:
    """Return a function that makes a tracker for a reference image, using this curve."""

    def make(image: AnyArray) -> PoseTracker:
        reference: Any = image
        return PoseTracker(reference, curve, min_dprime)

    return make
