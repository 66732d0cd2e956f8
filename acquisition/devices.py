"""The interfaces of every camera and every height stage, real or simulated.

Calls block, each with its own time limit; threads stay inside a driver.
"""

from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

FrameImage = NDArray[np.uint8] | NDArray[np.uint16]
StageState = Literal["idle", "moving", "homing", "hold", "door", "alarm", "unknown"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceInfo:
    """Identity that a device reports, for the snapshot in a session."""

    vendor: str
    model: str
    serial_number: str
    firmware: str
    driver: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """The settings a camera runs with, as read back from it.

    ``gain`` is in dB, a factor or counts, ``black_level`` in DN of 12 bits, % or counts; None where
    the camera states nothing. Counts have no known scale: ``gain_db`` is then None,
    ``black_level_dn`` 0. ``features`` holds what else was read, under the camera's own names.
    """

    width_px: int
    height_px: int
    pixel_format: str
    exposure_us: float
    gain_db: float | None
    frame_rate_hz: float
    black_level_dn: float
    gain: float | None = None
    gain_unit: str | None = None
    black_level: float | None = None
    black_level_unit: str | None = None
    features: dict[str, str | int | float | bool] = field(default_factory=dict)

    @property
    def max_level_dn(self) -> int:
        """Largest level the pixel format can hold, in DN."""
        bits = {"Mono8": 8, "Mono12": 12, "Mono12Packed": 12, "Mono16": 16}.get(self.pixel_format)
        if bits is None:
            bits = int("".join(c for c in self.pixel_format.removesuffix("Packed") if c.isdigit()))
        return int(2**bits - 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One exposure as the camera delivered it.

    An incomplete frame (lost packets) has ``is_complete`` False and an empty image.
    ``exposure_us`` and ``gain``, in the unit of `CameraSettings.gain`, are those that the camera
    states for this very frame; None if it states none.
    """

    image_dn: FrameImage
    frame_id: int
    timestamp_ns: int
    is_complete: bool = True
    exposure_us: float | None = None
    gain: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamStatistics:
    """Counts of frames and packets that a stream has delivered since it was opened.

    ``resends_packets`` is whether the camera sends lost packets again on request; None if there are
    no packets, or it is not known.
    """

    complete_frames: int
    incomplete_frames: int
    resent_packets: int
    missing_packets: int
    resends_packets: bool | None = None


@runtime_checkable
class Camera(Protocol):
    """One area camera that has been opened and configured."""

    @property
    def info(self) -> DeviceInfo:
        """Identity that the camera reports."""
        ...

    @property
    def settings(self) -> CameraSettings:
        """The settings it runs with, read back from the camera."""
        ...

    def set_exposure_us(self, exposure_us: float) -> float:
        """Set the exposure time and return the one read back, in us."""
        ...

    def set_gain_db(self, gain_db: float) -> float:
        """Set the gain and return the one read back, in dB.

        For a camera that counts gain without a scale, its lowest gain is returned as 0.
        """
        ...

    def start(self) -> None:
        """Start the stream; frames left from before are dropped."""
        ...

    def next_frame(self, timeout_s: float) -> Frame:
        """Wait for the next frame, complete or not.

        Raises
        ------
        DeviceTimeoutError
            If no frame came within ``timeout_s``.
        DeviceDisconnectedError
            If the connection to the camera is lost.
        """
        ...

    def stop(self) -> None:
        """End the stream; a stopped camera can be started again."""
        ...

    def statistics(self) -> StreamStatistics:
        """Frames and packets since the camera was opened."""
        ...

    def close(self) -> None:
        """Release the camera; closing twice is harmless."""
        ...


@runtime_checkable
class LimitedExposureCamera(Protocol):
    """A camera that states which exposures it accepts."""

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """Shortest and longest exposure, in us."""
        ...


@runtime_checkable
class Stage(Protocol):
    """One vertical axis; heights are in mm above its home offset."""

    @property
    def info(self) -> DeviceInfo:
        """Identity that the stage reports."""
        ...

    @property
    def limits_mm(self) -> tuple[float, float]:
        """Lowest and highest height that a move may ask for, in mm."""
        ...

    @property
    def is_homed(self) -> bool:
        """Whether the position is known, because the stage has been homed."""
        ...

    @property
    def state(self) -> StageState:
        """Present state of the stage."""
        ...

    def home(self, timeout_s: float) -> None:
        """Find the reference switch.

        Raises
        ------
        DeviceTimeoutError
            If the switch is not found within ``timeout_s``; the stage is stopped first.
        """
        ...

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        """Move, settle and return the height read back, in mm.

        Raises
        ------
        StageNotHomedError, StageLimitError
            If the position is not known, or the height is beyond the limits; nothing moves.
        DeviceTimeoutError
            If the stage has not settled within ``timeout_s``; it is stopped first.
        """
        ...

    def position_mm(self) -> float:
        """Height read back now, in mm."""
        ...

    def stop(self) -> None:
        """Stop with a controlled deceleration; the position stays known."""
        ...

    def emergency_stop(self) -> None:
        """Stop at once; the position is unknown until the stage is homed again."""
        ...

    def clear_alarm(self) -> None:
        """Leave an alarm state; moves nothing."""
        ...

    def close(self) -> None:
        """Release the port; closing twice is harmless."""
        ...


@runtime_checkable
class HomingStage(Protocol):
    """A stage whose controller states how far and how fast it homes."""

    @property
    def homing_s(self) -> float:
        """Longest homing by the controller's own travel and rates, in s; 0 if it states none."""
        ...


@runtime_checkable
class TravellingStage(Protocol):
    """A stage that reports its height while another thread moves it; for display only."""

    def travel_height_mm(self) -> float | None:
        """Height during a move, in mm; None if it is not known.

        It takes no part in the dialogue of the move: it can neither disturb the move nor hide an
        alarm from it.
        """
        ...
