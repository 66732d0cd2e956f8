"""The simulated bench in process: camera, stage and what lies under them."""

from dataclasses import replace

from acquisition.bench import BenchConfig
from hil_mocks.camera import SimulatedCamera
from hil_mocks.clock import SimulatedClock
from hil_mocks.scene import CameraPose
from hil_mocks.stage import SimulatedStage
from hil_mocks.target_bench import TargetBench


class SimulatedBench(TargetBench):
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
        """Where the camera truly is."""
        return replace(self._mounting, height_mm=self.stage.true_height_mm)

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
