"""What every simulated bench has: its truth, and a target under its camera."""

from abc import ABC, abstractmethod
from math import isfinite
from threading import RLock

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig
from hil_mocks.scene import TARGETS, BenchTruth, CameraPose, scene_of


class TargetBench(ABC):
    """A bench whose target can be exchanged, also while its camera runs in another thread.

    Raises
    ------
    BenchConfigError
        If the bench has no ``[simulated]`` section, or an impossible one.
    """

    def __init__(self, config: BenchConfig) -> None:
        self.truth = BenchTruth(config)
        self._lock = RLock()
        self._target, self._orientation_deg = "edge", 0.0

    @property
    def targets(self) -> tuple[str, ...]:
        """Names that `place` accepts."""
        return tuple(TARGETS)

    @property
    def target(self) -> str:
        """The target under the camera."""
        return self._target

    @property
    def orientation_deg(self) -> float:
        """Rotation of the target, from +x towards +y."""
        return self._orientation_deg

    @property
    @abstractmethod
    def pose(self) -> CameraPose:
        """True pose of the camera."""

    def place(self, target: str, orientation_deg: float = 0.0) -> None:
        """Place a target under the camera, as an operator would.

        Parameters
        ----------
        target
            One of `targets`.
        orientation_deg
            Rotation from +x towards +y (y is down) about the optical axis; for ``edge``, the
            direction of the edge line.

        Raises
        ------
        ValueError
            If there is no such target (the message lists them), or the angle is not finite.
        """
        scene_of(target)
        if not isfinite(orientation_deg):
            raise ValueError(f"the angle of a target must be finite, got {orientation_deg}")
        with self._lock:
            self._target, self._orientation_deg = target, orientation_deg

    def _look(self) -> NDArray[np.float32]:
        """Present light on the sensor."""
        with self._lock:
            return self.truth.irradiance(self._target, self._orientation_deg, self.pose)
