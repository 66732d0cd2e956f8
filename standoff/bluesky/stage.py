"""The height stage as a movable device of Bluesky."""

from typing import Any

from acquisition.stages import refuse_beyond_limits
from standoff.bluesky.readings import Signal, described, readings
from standoff.bluesky.status import WorkStatus
from standoff.library import Bench


class HeightStage:
    """Moves the stage of an open bench: ``Movable``, ``Stoppable``, ``Locatable``, ``Readable``.

    A move outside the travel is refused before the scan begins, where the plan is checked
    (``bluesky.simulators.check_limits``), and before anything moves. The stage must be homed.

    Parameters
    ----------
    bench
        Open for as long as the device is used.
    name
        First part of the keys in events.
    """

    parent = None

    def __init__(self, bench: Bench, *, name: str = "stage") -> None:
        self.name = name
        self._bench = bench
        self._setpoint_mm: float | None = None
        self._move: WorkStatus | None = None

    @property
    def hints(self) -> dict[str, list[str]]:
        """The key that a plot of a scan shows."""
        return {"fields": [f"{self.name}_height_mm"]}

    @property
    def position(self) -> float:
        """Height read back now, in mm, for relative scans."""
        return self._bench.height_mm

    def set(self, height_mm: float) -> WorkStatus:
        """Begin to move to a height; the status ends once the stage has settled there."""
        self._setpoint_mm = float(height_mm)
        self._move = WorkStatus(lambda: self._bench.move(float(height_mm)), f"{self.name} move")
        return self._move

    def check_value(self, height_mm: float) -> None:
        """Refuse a height outside the travel; moves nothing.

        Raises
        ------
        StageLimitError
            With the travel.
        """
        refuse_beyond_limits(height_mm, self._bench.limits_mm)

    def stop(self, *, success: bool = False) -> None:
        """End a move under control; a stage at rest is left alone."""
        if self._move is not None and not self._move.done:
            self._bench.stop()

    def locate(self) -> dict[str, float]:
        """Where the stage was sent, and where it is."""
        height_mm = self._bench.height_mm
        setpoint_mm = height_mm if self._setpoint_mm is None else self._setpoint_mm
        return {"setpoint": setpoint_mm, "readback": height_mm}

    def read(self) -> dict[str, Any]:
        """Height read back and asked for, in mm."""
        place = self.locate()
        return readings(
            {
                f"{self.name}_height_mm": place["readback"],
                f"{self.name}_setpoint_mm": place["setpoint"],
            }
        )

    def describe(self) -> dict[str, Any]:
        """Descriptions of ``read``."""
        source = f"standoff:stage/{self._bench.stage.info.model}"
        height = Signal(source=source, units="mm", precision=3)
        return described({f"{self.name}_{key}": height for key in ("height_mm", "setpoint_mm")})

    def read_configuration(self) -> dict[str, Any]:
        """Travel, and tolerance of a move."""
        low_mm, high_mm = self._bench.limits_mm
        return readings(
            {
                f"{self.name}_lowest_mm": low_mm,
                f"{self.name}_highest_mm": high_mm,
                f"{self.name}_tolerance_mm": self._bench.config.stage.tolerance_mm,
            }
        )

    def describe_configuration(self) -> dict[str, Any]:
        """Descriptions of ``read_configuration``."""
        signal = Signal(source="standoff:bench file", units="mm", precision=3)
        return described(
            {f"{self.name}_{key}_mm": signal for key in ("lowest", "highest", "tolerance")}
        )
