"""The simulated bench in process: camera, stage and what lies under them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig
from acquisition.errors import BenchConfigError
from hil_mocks.camera import SimulatedCamera
from hil_mocks.clock import SimulatedClock
from hil_mocks.scene import TARGETS, BenchTruth, CameraPose, scene_of
from hil_mocks.stage import SimulatedStage

__all__ = ["SimulatedBench"]


class SimulatedBench:
    """A camera that looks down from a stage on a target that an operator exchanges.

    The camera sees the stage's *true* height. To begin with, black and white paper lie there,
    their edge horizontal.

    Parameters
    ----------
    config
        A bench with a ``[simulated]`` section, which holds the truth.
    clock
        What both devices live by; time that passes only when one uses it, if None.

    Raises
    ------
    BenchConfigError
        If it has none, or one that no bench can have.
    """

    def __init__(self, config: BenchConfig, *, clock: SimulatedClock | None = None) -> None:
        if config.simulated is None:
            raise BenchConfigError("the bench has no [simulated] section", keys=("simulated",))
        self.truth = BenchTruth(config)
        self.clock = SimulatedClock() if clock is None else clock
        self.stage = SimulatedStage(config.stage, clock=self.clock)
        self.camera = SimulatedCamera(
            config.camera,
            sensor=self.truth.sensor,
            look=self._look,
            shape=(config.simulated.height_px, config.simulated.width_px),
            clock=self.clock,
            seed=config.simulated.seed,
        )
        self._target = "edge"
        self._orientation_deg = 0.0
        self._mounting = CameraPose(height_mm=0.0)

    @property
    def targets(self) -> tuple[str, ...]:
        """Names that `place` takes."""
        return tuple(TARGETS)

    @property
    def target(self) -> str:
        """What lies under the camera."""
        return self._target

    @property
    def orientation_deg(self) -> float:
        """How the target is turned, from +x towards +y."""
        return self._orientation_deg

    @property
    def pose(self) -> CameraPose:
        """Where the camera truly is."""
        return replace(self._mounting, height_mm=self.stage.true_height_mm)

    def place(self, target: str, orientation_deg: float = 0.0) -> None:
        """Lay a target under the camera, as an operator would.

        Parameters
        ----------
        target
            One of `targets`.
        orientation_deg
            Turn from +x towards +y (y is down) about the optical axis; for ``edge`` the
            direction of the edge line.

        Raises
        ------
        ValueError
            If there is no such target; the message lists them.
        """
        scene_of(target)
        self._target, self._orientation_deg = target, orientation_deg

    def mount(
        self,
        *,
        offset_x_mm: float = 0.0,
        offset_y_mm: float = 0.0,
        roll_deg: float = 0.0,
        tilt_x_deg: float = 0.0,
        tilt_y_deg: float = 0.0,
    ) -> None:
        """Screw the camera to the stage in another way; see `CameraPose`."""
        self._mounting = CameraPose(
            height_mm=0.0,
            offset_x_mm=offset_x_mm,
            offset_y_mm=offset_y_mm,
            roll_deg=roll_deg,
            tilt_x_deg=tilt_x_deg,
            tilt_y_deg=tilt_y_deg,
        )

    def _look(self) -> NDArray[np.float32]:
        return self.truth.irradiance(self._target, self._orientation_deg, self.pose)
