"""The in-process simulated bench: camera, stage and the target under them."""

from dataclasses import replace

from acquisition.bench import BenchConfig
from hil_mocks.camera import SimulatedCamera
from hil_mocks.clock import SimulatedClock
from hil_mocks.scene import CameraPose
from hil_mocks.stage import SimulatedStage
from hil_mocks.target_bench import TargetBench


class SimulatedBench(TargetBench):
    """A camera on a stage that looks down on a target, which an operator can exchange.

    The camera sees from the stage's *true* height. At first the target is black and white paper
    with a horizontal edge.

    Parameters
    ----------
    config
        A bench with a ``[simulated]`` section, which holds the truth.
    clock
        Clock of both devices; by default, one whose time passes only when a device uses it.

    Raises
    ------
    BenchConfigError
        If it has no such section, or an impossible one.
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
        """The camera; one that was lost or closed is opened again, as its driver would do."""
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
        """Mount the camera on the stage differently; see `CameraPose`."""
        self._mounting = CameraPose(
            height_mm=0.0,
            offset_x_mm=offset_x_mm,
            offset_y_mm=offset_y_mm,
            roll_deg=roll_deg,
            tilt_x_deg=tilt_x_deg,
            tilt_y_deg=tilt_y_deg,
        )
