"""The frame thread of the simulated GigE camera: free-running, triggered, or a few frames."""

import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from threading import Condition, RLock, Thread
from time import monotonic

import numpy as np

from hil_mocks.camera import following_frame_id
from hil_mocks.gige.faults import GigeFaults
from hil_mocks.gige.feature import Feature
from hil_mocks.gige.frame_source import FrameRequest, FrameSource
from hil_mocks.gige.gvsp import (
    PAYLOAD_TYPE_IMAGE,
    PAYLOAD_TYPE_IMAGE_AND_CHUNKS,
    ImageLeader,
    encode_chunks,
)
from hil_mocks.gige.pixels import PixelLayout, wire_bytes
from hil_mocks.gige.processing import processed
from hil_mocks.gige.registers import RegisterMap, StreamTarget
from hil_mocks.gige.settings import CameraState, software_triggers, trigger_waits
from hil_mocks.gige.stream import Block, StreamSender

CONTINUOUS, SINGLE_FRAME = 0, 1
POLL_WHILE_STALLED_S = 0.02
EXPOSURES_KEPT = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class _Exposure:
    """The settings of one frame, as they were at its start."""

    request: FrameRequest
    block_id: int
    timestamp_ticks: int
    layout: PixelLayout
    region: tuple[slice, slice]
    settings: Mapping[str, float]
    chunks: tuple[Feature, ...]
    counter: int
    target: StreamTarget
    bandwidth_bps: float


class Acquisition:
    """Takes one frame per period or per trigger from the source and hands it to the sender.

    Block ids begin at 1 after every start.

    Parameters
    ----------
    source
        Makes the frames.
    state, registers, lock
        The camera's settings and the lock that guards them.
    sender
        Sends the frames.
    faults
        The present faults.
    """

    def __init__(
        self,
        source: FrameSource,
        state: CameraState,
        registers: RegisterMap,
        lock: RLock,
        sender: StreamSender,
        faults: Callable[[], GigeFaults],
    ) -> None:
        self.payload_type_of_chunks = PAYLOAD_TYPE_IMAGE_AND_CHUNKS
        self.tell_exposure_end: Callable[[int, int], None] = lambda _block_id, _ticks: None
        self._source = source
        self._state = state
        self._registers = registers
        self._sender = sender
        self._faults = faults
        self._changed = Condition(lock)
        self._is_closing = False
        self._acquisitions = 0
        self._frames = 0
        self._counter = 0
        self._frames_left: int | None = None
        self._triggers: list[float] = []
        self._due_s = 0.0
        self._exposed_s = 0.0
        self.first_block_id = 1
        self._block_id = 0
        self._set_db: deque[float] = deque(maxlen=EXPOSURES_KEPT)
        self._set_us: deque[float] = deque(maxlen=EXPOSURES_KEPT)
        self._thread = Thread(target=self._run, name="gige-stream", daemon=True)

    @property
    def acquisitions(self) -> int:
        """Number of acquisition starts since power-up."""
        return self._acquisitions

    def open(self) -> None:
        """Start the thread, which waits for a start of acquisition."""
        self._thread.start()

    def close(self) -> None:
        """End the thread, at the latest after the frame that it is sending."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._thread.join()

    def start(self) -> None:
        """Take frames from now on."""
        with self._changed:
            if self._state.is_acquiring:
                return
            mode = int(self._state.quantity("AcquisitionMode"))
            self._frames_left = None
            if mode != CONTINUOUS:
                count = int(self._state.quantity("AcquisitionFrameCount"))
                self._frames_left = 1 if mode == SINGLE_FRAME else count
            self._acquisitions += 1
            self._frames = 0
            self._triggers.clear()
            self._block_id = self.first_block_id
            self._sender.forget()
            self._due_s = monotonic() + self._state.quantity("ExposureTimeAbs") * 1e-6
            self._state.is_acquiring = True
            self._changed.notify_all()

    def stop(self) -> None:
        """Take no more frames."""
        with self._changed:
            self._state.is_acquiring = False
            self._changed.notify_all()

    def trigger(self) -> None:
        """Take one frame, if frames wait for the software trigger and none is being exposed."""
        with self._changed:
            self._take_one(software_triggers(self._state.values))

    def pulse(self, line: int) -> None:
        """Take one frame, if frames wait for this line and none is being exposed."""
        with self._changed:
            values = self._state.values
            self._take_one(bool(values["TriggerMode"]) and values["TriggerSource"] == line)

    def _take_one(self, is_awaited: bool) -> None:
        if is_awaited and self._state.is_acquiring and not self._triggers:
            self._triggers.append(monotonic())
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                if not self._wait_for_frame():
                    return
                exposure = self._expose()
            self.tell_exposure_end(exposure.block_id, exposure.timestamp_ticks)
            self._deliver(exposure)

    def _wait_for_frame(self) -> bool:
        """Wait until the next frame is due; False if the camera closes."""
        while not self._is_closing:
            if not self._state.is_acquiring:
                self._changed.wait()
            elif self._faults().is_stalled or self._faults().is_dead:
                self._changed.wait(POLL_WHILE_STALLED_S)
                self._due_s = monotonic()
            elif trigger_waits(self._state.values):
                if not self._triggers:
                    self._changed.wait()
                elif self._has_come(self._triggers[0] + self._exposure_s):
                    self._exposed_s = self._triggers.pop(0) + self._exposure_s
                    return True
            elif self._has_come(self._due_s):
                # The time stamp is the sensor's, not that of a busy machine; and a late frame
                # does not hurry those that follow.
                self._exposed_s = self._due_s
                self._due_s = max(self._due_s + self._state.frame_period_s, monotonic())
                return True
        return False

    def _has_come(self, moment_s: float) -> bool:
        left_s = moment_s - monotonic()
        if left_s > 0:
            self._changed.wait(left_s)
        return left_s <= 0

    @property
    def _exposure_s(self) -> float:
        return self._state.quantity("ExposureTimeAbs") * 1e-6

    def _expose(self) -> _Exposure:
        block_id = self._block_id
        request = self._state.request(self._acquisitions, self._frames)
        self._set_us.append(request.exposure_us)
        self._set_db.append(request.gain_db)
        late = min(self._faults().exposure_delay_frames, len(self._set_us) - 1)
        gain_late = min(self._faults().gain_delay_frames, len(self._set_db) - 1)
        self._counter += 1
        exposure = _Exposure(
            request=replace(
                request,
                exposure_us=self._set_us[-1 - late],
                gain_db=self._set_db[-1 - gain_late],
            ),
            block_id=block_id,
            timestamp_ticks=self._registers.ticks_at(self._exposed_s),
            layout=self._state.layout,
            region=self._state.region,
            settings=dict(self._state.values),
            chunks=self._state.chunks,
            counter=self._counter,
            target=self._registers.stream_target,
            bandwidth_bps=self._state.quantity("StreamBytesPerSecond"),
        )
        self._frames += 1
        self._block_id = following_frame_id(block_id)
        if self._frames_left is not None:
            self._frames_left -= 1
            self._state.is_acquiring = self._frames_left > 0
        return exposure

    def _deliver(self, exposure: _Exposure) -> None:
        level_dn = self._source.levels_dn(exposure.request)
        rows, cols = exposure.region
        rows = slice(rows.start, max(rows.start + 1, rows.stop - self._faults().missing_rows))
        level_dn = level_dn[rows, cols]
        if self._state.is_automatic:
            with self._changed:
                self._state.regulate(float(level_dn.mean()))
        level_dn = processed(level_dn, exposure.settings)
        leader = ImageLeader(
            timestamp_ticks=exposure.timestamp_ticks,
            pixel_format=exposure.layout.code,
            width=level_dn.shape[1],
            height=level_dn.shape[0],
            offset_x=cols.start,
            offset_y=rows.start,
            payload_type=self.payload_type_of_chunks if exposure.chunks else PAYLOAD_TYPE_IMAGE,
        )
        image_bytes = wire_bytes(level_dn, exposure.layout)
        if exposure.chunks:
            chunks = {chunk.chunk_id or 0: _chunk(chunk, exposure) for chunk in exposure.chunks}
            image_bytes = np.frombuffer(encode_chunks(image_bytes.tobytes(), chunks), np.uint8)
        block = Block.of_image(
            exposure.block_id,
            leader,
            image_bytes,
            exposure.target.packet_size_bytes,
        )
        self._sender.send_block(block, exposure.target, exposure.bandwidth_bps)


def _chunk(chunk: Feature, exposure: _Exposure) -> bytes:
    """What a chunk says of a frame; integers and floats take eight bytes."""
    quantities = {
        "ExposureTimeAbs": exposure.request.exposure_us,
        "Gain": exposure.request.gain_db - exposure.settings["DigitalGain"],
        "Timestamp": exposure.timestamp_ticks,
        "FrameCounter": exposure.counter,
    }
    value = quantities[chunk.means[0][1]]
    return struct.pack(">d", value) if chunk.kind == "float" else struct.pack(">Q", int(value))
