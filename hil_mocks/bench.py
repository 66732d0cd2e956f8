"""The in-process simulated bench: camera, stage, and a target under them."""

from abc import ABC, abstractmethod
from dataclasses import replace
from math import isfinite
from threading import RLock

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig
from hil_mocks.devices import SimulatedCamera, SimulatedClock, SimulatedStage
from hil_mocks.truth import TARGETS, BenchTruth, CameraPose, scene_of


class TargetBench(ABC):
    """A bench whose target can be exchanged, even while its camera runs in another thread.

    A BenchConfigError is raised if the bench has no ``[simulated]`` section, or an invalid one.
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
        """Rotation of the target in degrees, from +x towards +y."""
        return self._orientation_deg

    @property
    @abstractmethod
    def pose(self) -> CameraPose:
        """True pose of the camera."""

    def place(self, target: str, orientation_deg: float = 0.0) -> None:
        """Place one of `targets` under the camera, as an operator would.

        It is turned about the optical axis by ``orientation_deg`` from +x towards +y (y is down);
        for ``edge``, that is the direction of the edge line. A ValueError is raised if there is no
        such target (the message lists those that exist), or if the angle is not finite.
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


class SimulatedBench(TargetBench):
    """A simulated camera that looks down from a stage on a target, which can be exchanged.

    The picture is that from the stage's *true* height. The first target is black and white paper
    with a horizontal edge. ``clock`` is the clock of both devices, by default a simulated one whose
    time passes only when a device uses it. A BenchConfigError is raised if the bench has no
    ``[simulated]`` section, which holds the truth, or an invalid one.
    """

    def __init__(self, config: BenchConfig, *, clock: SimulatedClock | None = None) -> None:
        super().__init__(config)
        settings = self.truth.settings
        self.clock = SimulatedClock() if clock is None else clock
        self.stage = SimulatedStage(config.stage, clock=self.clock)
        self.camera = SimulatedCamera(
            config.camera,
            sensor=self.truth.sensor,
            look=self._look,
            shape=(settings.height_px, settings.width_px),
            clock=self.clock,
            seed=settings.seed,
        )
        self._mounting = CameraPose(height_mm=0.0)

    @property
    def pose(self) -> CameraPose:
        """True pose of the camera."""
        return replace(self._mounting, height_mm=self.stage.true_height_mm)

    def open_camera(self) -> SimulatedCamera:
        """Return the camera; if it was lost or closed it is opened again, as a driver would do."""
        if not self.camera.is_open:
            self.camera = self.camera.reopened()
        return self.camera

    def mount(
        self,
        *,
        offset_x_mm: float = 0.0,
        offset_y_mm: float = 0.0,
        roll_deg: float = 0.0,
        tilt_x_deg: float = 0.0,
        tilt_y_deg: float = 0.0,
    ) -> None:
        """Set how the camera is mounted on the stage; see `CameraPose`."""
        self._mounting = CameraPose(
            height_mm=0.0,
            offset_x_mm=offset_x_mm,
            offset_y_mm=offset_y_mm,
            roll_deg=roll_deg,
            tilt_x_deg=tilt_x_deg,
            tilt_y_deg=tilt_y_deg,
        )
