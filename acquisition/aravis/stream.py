"""Frames from an Aravis stream: buffers in flight, their state, the copy out of them."""

import math

import numpy as np

from acquisition.aravis.chunks import FrameChunks, FrameFacts
from acquisition.aravis.device import OpenedDevice
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.frame_memory import FrameMemory
from acquisition.aravis.library import AravisObject
from acquisition.aravis.pixel_decoding import decode_pixels, encoded_bytes
from acquisition.devices import CameraSettings, Frame, StreamStatistics
from acquisition.errors import CameraFeatureError, DeviceDisconnectedError

SOCKET_BUFFER_BYTES = 4 * 2**20
"""Room for over four frames of 780x580x2 in the kernel while this program is not scheduled."""

BUFFERED_S = 0.3
MIN_BUFFERS, MAX_BUFFERS = 8, 64
"""Length of the frame queue as a time; the bounds suit slow and fast cameras."""

ABORT = "AcquisitionAbort"

LARGEST_IMAGE_BYTES = 1 << 30
LARGEST_CHUNKS_BYTES = 1 << 20
"""What a frame may have beside its picture, and padding as large as that; memory is taken for
dozens of frames, and a computer without any ends the program."""

LENT_MOST = 6
"""Images in use before others are copied: an average takes them by fours."""


class FrameStream:
    """A stream channel with its receive thread; it is dropped with its connection.

    Parameters
    ----------
    opened
        The camera, configured.
    settings
        Its settings.
    chunks
        What it states with each frame; None if it is not asked to.
    """

    def __init__(
        self, opened: OpenedDevice, settings: CameraSettings, chunks: FrameChunks | None = None
    ) -> None:
        self._opened = opened
        self._chunks = chunks
        self._shape = (settings.height_px, settings.width_px)
        library = opened.library
        self._format_name = settings.pixel_format
        # After a leader that it cannot read, Aravis 0.8.26 delivers the buffer as a success with
        # what an earlier frame left in it. Time stamps ascend: such a frame is not newer.
        self._newest_ns = -1
        # The counter and time stamp inside the frame, where the camera has them, change as well.
        self._newest_facts = FrameFacts()
        self._packets_before = (0, 0)
        # Compiled before the stream runs: the first time takes a second, and no frame waits.
        decode_pixels(bytes(encoded_bytes(self._format_name, (1, 2))), self._format_name, (1, 2))
        self._success = library.api.BufferStatus.SUCCESS
        payloads = library.api.BufferPayloadType
        self._image_payload = payloads.IMAGE
        self._chunk_payload = payloads.CHUNK_DATA
        with translated_errors(library, "the stream channel"):
            self._format_code = int(opened.camera.get_pixel_format())
            payload_bytes = int(opened.camera.get_payload())
            image_bytes = encoded_bytes(self._format_name, self._shape)
            _require_plausible(payload_bytes, image_bytes)
            if opened.is_gige:
                # As root, Aravis reads a packet socket: that hides a small receive buffer.
                opened.camera.gv_set_stream_options(
                    library.api.GvStreamOption.PACKET_SOCKET_DISABLED
                )
            self._resends_packets = opened.resends_packets
            self._made: AravisObject = opened.camera.create_stream(None, None)
        if opened.is_gige:
            self._stream.set_property("socket-buffer", library.api.GvStreamSocketBuffer.FIXED)
            self._stream.set_property("socket-buffer-size", SOCKET_BUFFER_BYTES)
        wanted = math.ceil(BUFFERED_S * settings.frame_rate_hz)
        self._memory = FrameMemory(
            library,
            self._made,
            buffers=min(max(wanted, MIN_BUFFERS), MAX_BUFFERS),
            buffer_bytes=payload_bytes,
            image_bytes=image_bytes,
            lent_most=LENT_MOST,
        )

    @property
    def _stream(self) -> AravisObject:
        if self._made is None:
            raise DeviceDisconnectedError("the connection to the camera is closed")
        return self._made

    def start(self) -> None:
        """Drop waiting frames, then start."""
        # The receive thread takes a block id up to a hundred behind the last for a late packet of
        # an old block and drops it (Aravis 0.8.26). Cameras count from 1 after each start, so
        # a short series would cost the next one its first frames: a new thread starts afresh.
        self._restart_thread()
        self._newest_facts = FrameFacts()  # some cameras count from the start of the series
        with translated_errors(self._opened.library, "AcquisitionStart"):
            self._opened.camera.start_acquisition()

    def stop(self, *, is_exposing_long: bool = False) -> None:
        """Stop; frames that still arrive are dropped at the next start.

        A long exposure is aborted where the camera can: after a mere stop it is finished first.
        """
        camera = self._opened.camera
        if is_exposing_long:
            with translated_errors(self._opened.library, ABORT):
                if camera.is_feature_available(ABORT):
                    camera.abort_acquisition()
        with translated_errors(self._opened.library, "AcquisitionStop"):
            camera.stop_acquisition()

    def pop(self, timeout_s: float) -> Frame | None:
        """Next frame, complete or not, or None if none came within ``timeout_s``."""
        buffer = self._stream.timeout_pop_buffer(max(0, round(1e6 * timeout_s)))
        if buffer is None:
            return None
        self._packets_before = self._packets()
        frame_id, timestamp_ns = int(buffer.get_frame_id()), int(buffer.get_timestamp())
        try:
            picture = self._picture_in(buffer, timestamp_ns)
        except BaseException:
            self._memory.push(buffer)
            raise
        if picture is None:
            self._memory.push(buffer)
        else:
            shape, facts = picture
            data = self._memory.lend(buffer, encoded_bytes(self._format_name, shape))
            if data is not None:
                self._newest_ns, self._newest_facts = timestamp_ns, facts
                return Frame(
                    image_dn=decode_pixels(data, self._format_name, shape),
                    frame_id=frame_id,
                    timestamp_ns=timestamp_ns,
                    exposure_us=facts.exposure_us,
                    gain=facts.gain,
                )
        return Frame(
            image_dn=np.empty((0, 0), np.uint16),
            frame_id=frame_id,
            timestamp_ns=timestamp_ns,
            is_complete=False,
        )

    def restart_if_deaf(self) -> bool:
        """Start the receive thread anew if it drops what comes; returns whether it did.

        A late packet of an earlier series, such as the answer to a request for one, may be the
        first that a new thread sees. It then takes the blocks of this series, which count from 1
        again, for late ones, up to a hundred behind (Aravis 0.8.26). What it dropped is lost.
        """
        dropped, taken = (
            now - before for now, before in zip(self._packets(), self._packets_before, strict=True)
        )
        # Of packets that come twice or late it drops no more than it takes of others.
        if dropped <= taken:
            return False
        self._restart_thread()
        return True

    def statistics(self) -> StreamStatistics:
        """Frames and packets since the stream was made."""
        # The instance's get_statistics() is GObject's, with another meaning; Aravis' takes the
        # stream as an argument. Its third figure, "underruns", counts packets, not frames.
        complete, incomplete, _ = self._opened.library.api.Stream.get_statistics(self._stream)
        if not self._opened.is_gige:
            return StreamStatistics(
                complete_frames=int(complete),
                incomplete_frames=int(incomplete),
                resent_packets=0,
                missing_packets=0,
            )
        return StreamStatistics(
            complete_frames=int(complete),
            incomplete_frames=int(incomplete),
            resent_packets=int(self._stream.get_info_uint64_by_name("n_resent_packets")),
            missing_packets=int(self._stream.get_info_uint64_by_name("n_missing_packets")),
            resends_packets=self._resends_packets,
        )

    def close(self) -> None:
        """End the receive thread and release the socket; closing twice is harmless.

        This writes to the camera, so close the device only afterwards, and make no other stream
        of the camera before: its port would be cleared (Aravis 0.8.26).
        """
        if self._chunks is not None:
            self._chunks.close()
        if self._made is None:
            return
        gone = self._made.weak_ref()
        self._memory.detach()
        self._made = None
        # Whoever else refers to the stream keeps its thread going, which writes to the memory.
        if gone() is None:
            self._memory.release()

    def _restart_thread(self) -> None:
        """Drop waiting frames; the new receive thread knows of no earlier block."""
        self._stream.stop_thread(False)
        self._drain()
        self._packets_before = self._packets()
        self._stream.start_thread()

    def _packets(self) -> tuple[int, int]:
        """Packets that the receive thread has dropped, and that it has taken."""
        if not self._opened.is_gige:
            return 0, 0
        dropped = int(self._stream.get_info_uint64_by_name("n_ignored_packets"))
        return dropped, int(self._stream.get_info_uint64_by_name("n_received_packets")) - dropped

    def _drain(self) -> None:
        # Aravis never overwrites a frame that was not fetched: it would be delivered first.
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._memory.push(buffer)

    def _picture_in(
        self, buffer: AravisObject, timestamp_ns: int
    ) -> tuple[tuple[int, int], FrameFacts] | None:
        """``(rows, cols)`` of a complete picture and what it says of itself; None if it is none."""
        # The state comes first: an incomplete buffer has no picture to ask about.
        if buffer.get_status() != self._success or timestamp_ns <= self._newest_ns:
            return None
        shape = self._shape_of(buffer)
        facts = FrameFacts() if self._chunks is None else self._chunks.read(buffer)
        if shape is None or facts is None or not self._is_newer(facts):
            return None
        return shape, facts

    def _shape_of(self, buffer: AravisObject) -> tuple[int, int] | None:
        """``(rows, cols)`` of a picture in the format that was set; None if it is none."""
        payload = buffer.get_payload_type()
        if payload == self._chunk_payload and self._chunks is not None:
            return self._shape  # the leader of such a block tells neither size nor format
        if (
            payload != self._image_payload
            or int(buffer.get_image_pixel_format()) != self._format_code
        ):
            return None
        return int(buffer.get_image_height()), int(buffer.get_image_width())

    def _is_newer(self, facts: FrameFacts) -> bool:
        """Whether the camera's own counter and time stamp say so too, where it states them."""
        before = self._newest_facts
        pairs = (
            (before.counter, facts.counter),
            (before.timestamp_ticks, facts.timestamp_ticks),
        )
        return all(old is None or new is None or new != old for old, new in pairs)


def _require_plausible(payload_bytes: int, image_bytes: int) -> None:
    """Refuse a frame that no memory holds, or that does not hold its picture.

    Raises
    ------
    CameraFeatureError
        Names the feature at fault.
    """
    if image_bytes > LARGEST_IMAGE_BYTES:
        raise CameraFeatureError(
            f"a picture of {image_bytes} bytes is too large; set camera.region_px to a smaller one",
            feature="Width",
        )
    if not image_bytes <= payload_bytes <= 2 * image_bytes + LARGEST_CHUNKS_BYTES:
        raise CameraFeatureError(
            f"the camera says that a frame has {payload_bytes} bytes (PayloadSize), of which its "
            f"picture takes {image_bytes}; restart the camera, or install the firmware anew",
            feature="PayloadSize",
        )


def total_statistics(one: StreamStatistics, other: StreamStatistics) -> StreamStatistics:
    """Counts of two streams together."""
    return StreamStatistics(
        complete_frames=one.complete_frames + other.complete_frames,
        incomplete_frames=one.incomplete_frames + other.incomplete_frames,
        resent_packets=one.resent_packets + other.resent_packets,
        missing_packets=one.missing_packets + other.missing_packets,
        resends_packets=other.resends_packets,
    )
