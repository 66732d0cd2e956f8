"""A simulated stage on a pseudo-terminal: mechanics, controller and port, in real time."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from types import TracebackType
from typing import Literal, Self

from hil_mocks.stages.grbl import GrblFirmware
from hil_mocks.stages.plant import StagePlant
from hil_mocks.stages.pty_port import PtyPort
from hil_mocks.stages.serial_line import SerialLine
from hil_mocks.stages.zaber import ZaberFirmware

StageProtocol = Literal["grbl", "zaber"]

LOW_SWITCH_MM, HIGH_SWITCH_MM = 119.5, 519.5
START_MM = 300.0
"""Travel as in the shipped ``grbl_stage.toml`` and ``zaber_stage.toml``."""


class SerialStage:
    """Stands in for a commercial stage; the simulated camera sees its true height.

    The Grbl controller is grblHAL: opening its port does not reset it.

    Parameters
    ----------
    protocol
        Protocol of the controller.
    clock
        Time in seconds; ``time.monotonic`` times a factor makes it run faster.
    """

    def __init__(self, protocol: StageProtocol, *, clock: Callable[[], float] = monotonic) -> None:
        start_s = clock()
        self.plant = StagePlant(
            low_switch_mm=LOW_SWITCH_MM, high_switch_mm=HIGH_SWITCH_MM, start_mm=START_MM
        )
        self.firmware: GrblFirmware | ZaberFirmware = (
            GrblFirmware(self.plant, dialect="grblhal")
            if protocol == "grbl"
            else ZaberFirmware(self.plant)
        )
        self.line = SerialLine(self.firmware)
        self._pty = PtyPort(self.line, clock=lambda: clock() - start_s)

    @property
    def port(self) -> str:
        """Path of its serial port, once open."""
        return self._pty.path

    @property
    def true_height_mm(self) -> float:
        """Present true height of the camera."""
        with self._pty.locked():
            return self.plant.true_height_mm

    def plug_in(self) -> None:
        """Plug the cable back in after a fault has pulled it out; ``port`` may change."""
        self._pty.plug_in()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Halt everything while a part is changed."""
        with self._pty.locked():
            yield

    def __enter__(self) -> Self:
        self._pty.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pty.close()
