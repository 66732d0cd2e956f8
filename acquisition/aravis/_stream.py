"""Frames from an Aravis stream: buffers in flight, their state, what each frame says of itself.

Images are read without a copy from the memory that Aravis receives frames into. Mono12Packed and
BayerXX12Packed put two pixels in three bytes: the high eight bits of the first, a byte with the low
four bits of both (the first pixel's in the low nibble), the high eight bits of the second. Pixels
follow each other across the ends of rows; the last of an odd number takes two bytes. Everything
else is one byte, or two bytes little-endian with the value in the low bits.

References
----------
AIA, GigE Vision, version 2.0 (2011), section "Pixel layouts", GVSP_PIX_MONO12_PACKED.
"""

import ctypes
import math
import re
import weakref
from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from acquisition.aravis._device import AravisLibrary, AravisObject, OpenedDevice, translated_errors
from acquisition.aravis._features import US_PER_UNIT, CameraFeatures, FeatureName, names_for
from acquisition.devices import CameraSettings, Frame, FrameImage, StreamStatistics
from acquisition.errors import CameraDescriptionError, CameraFeatureError, DeviceDisconnectedError

_WIRE_WORD = np.dtype("<u2")
_FORMAT = re.compile(r"(?:Mono|Bayer(?:RG|GR|GB|BG))(8|10|12|14|16|12Packed)")


def can_decode(pixel_format: str) -> bool:
    """Whether `_decode_pixels` supports the PFNC name."""
    return _FORMAT.fullmatch(pixel_format) is not None


def _encoded_bytes(pixel_format: str, shape: tuple[int, int]) -> int:
    """Number of bytes that an image of ``(rows, cols)`` takes on the wire."""
    pixels = shape[0] * shape[1]
    depth = _depth(pixel_format)
    if depth == "12Packed":
        return (3 * pixels + 1) // 2
    return pixels if depth == "8" else 2 * pixels


def _decode_pixels(
    data: bytes | memoryview, pixel_format: str, shape: tuple[int, int]
) -> FrameImage:
    """Decode ``data`` to levels in DN of a PFNC format; colour mosaics stay mosaics.

    The result is uint8 or uint16 of ``shape``, read-only where it shares the memory of ``data``, as
    all but the packed formats do.
    """
    size = _encoded_bytes(pixel_format, shape)
    if len(data) < size:
        raise ValueError(
            f"a {pixel_format} image of {shape[1]}x{shape[0]} takes {size} bytes, got {len(data)}"
        )
    depth = _depth(pixel_format)
    if depth == "8":
        return np.frombuffer(data, np.uint8, size).reshape(shape)
    if depth == "12Packed":
        pixels_dn = np.empty(shape, np.uint16)
        _unpack_12(np.frombuffer(data, np.uint8, size), pixels_dn.reshape(-1))
        return pixels_dn
    wire = np.frombuffer(data, _WIRE_WORD, size // 2).reshape(shape)
    return wire.astype(np.uint16, copy=False)


@cache
def _depth(pixel_format: str) -> str:
    match = _FORMAT.fullmatch(pixel_format)
    if match is None:
        raise ValueError(f"pixel format {pixel_format!r} cannot be decoded")
    return match[1]


@njit(cache=True)
def _unpack_12(packed: NDArray[np.uint8], pixels_dn: NDArray[np.uint16]) -> None:
    for pair in range(pixels_dn.size // 2):
        nibbles = np.uint16(packed[3 * pair + 1])
        pixels_dn[2 * pair] = (np.uint16(packed[3 * pair]) << 4) | (nibbles & 15)
        pixels_dn[2 * pair + 1] = (np.uint16(packed[3 * pair + 2]) << 4) | (nibbles >> 4)
    if pixels_dn.size % 2:
        pixels_dn[-1] = (np.uint16(packed[-2]) << 4) | (packed[-1] & 15)


SENTINEL = bytes.fromhex("a5 3c f1 0e 96 69 d2 5b b4 87 e8 1d c3 7a 2f 50")
"""Laid at an image's end before its buffer is filled: still there, the image came too short."""

_BEYOND_BYTES = 4096
"""Memory after each buffer: a register in a chunk may lie behind the end of what came, and Aravis
0.8.26 reads it there all the same."""


class _FrameMemory:
    """The buffers of one stream, of which ``buffers`` wait for frames at any time.

    An image is read where it was received; its buffer goes back when nothing refers to it. A
    program that keeps images gets copies once ``lent_most`` are in use.
    """

    def __init__(
        self,
        library: AravisLibrary,
        stream: AravisObject,
        *,
        buffers: int,
        buffer_bytes: int,
        image_bytes: int,
        lent_most: int,
    ) -> None:
        self._stream: AravisObject | None = stream
        self._image_bytes = image_bytes
        self._buffer_bytes = buffer_bytes
        self._end = max(0, min(image_bytes, buffer_bytes) - len(SENTINEL))
        self._sentinel = SENTINEL[: buffer_bytes - self._end]
        self._image = ctypes.c_uint8 * image_bytes
        self._lent_most = lent_most
        self._lent: dict[AravisObject, weakref.ref[ctypes.Array[ctypes.c_uint8]]] = {}
        self._addresses: dict[AravisObject, int] = {}
        self._blocks: dict[AravisObject, ctypes.Array[ctypes.c_uint8]] = {}
        for _ in range(buffers + lent_most):
            block = (ctypes.c_uint8 * (buffer_bytes + _BEYOND_BYTES))()
            address = ctypes.addressof(block)
            buffer = library.api.Buffer.new(buffer_bytes, address)
            self._blocks[buffer], self._addresses[buffer] = block, address
            self.push(buffer)
        # Aravis' thread writes here, also while an interpreter ends: only `release` frees it.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._blocks))

    def push(self, buffer: AravisObject) -> None:
        """Give a buffer back to the stream, to be filled again."""
        stream = self._stream
        if stream is not None:
            ctypes.memmove(self._addresses[buffer] + self._end, self._sentinel, len(self._sentinel))
            stream.push_buffer(buffer)

    def lend(self, buffer: AravisObject, image_bytes: int) -> memoryview | bytes | None:
        """The bytes of a complete image, or None; the buffer goes back once they are unused."""
        address = self._addresses[buffer]
        is_whole = image_bytes == self._image_bytes
        end = ctypes.string_at(address + self._end, len(self._sentinel))
        if image_bytes > self._buffer_bytes or (is_whole and end == self._sentinel):
            self.push(buffer)
            return None
        if not is_whole or len(self._lent) >= self._lent_most:
            copied = ctypes.string_at(address, image_bytes)
            self.push(buffer)
            return copied
        lease = self._image.from_address(address)
        # An image may outlive the stream.
        lease.block = self._blocks[buffer]  # type: ignore[attr-defined]
        self._lent[buffer] = weakref.ref(lease, lambda _: self._return(buffer))
        return memoryview(lease).toreadonly()

    def detach(self) -> None:
        """Give nothing back any more: the stream is about to end."""
        self._stream = None

    def release(self) -> None:
        """Let go of the memory, once, when nothing can write to it any more."""
        ctypes.pythonapi.Py_DecRef(ctypes.py_object(self._blocks))

    def _return(self, buffer: AravisObject) -> None:
        del self._lent[buffer]
        self.push(buffer)


_CHUNK_MODE = "ChunkModeActive"
_GAIN = "Gain"
"""The only feature of which a chunk states the gain: of one by another name the unit differs."""

_CHUNK_SELECTOR, _CHUNK_ENABLE = "ChunkSelector", "ChunkEnable"


@dataclass(frozen=True, slots=True, kw_only=True)
class _FrameFacts:
    """What a frame says of itself; None where the camera does not state it."""

    exposure_us: float | None = None
    gain: float | None = None
    counter: int | None = None
    timestamp_ticks: int | None = None


class FrameChunks:
    """The chunks of one camera; the payload grows by those that are switched on here."""

    def __init__(self, opened: OpenedDevice, features: CameraFeatures, camera: str) -> None:
        self._opened = opened
        self._parser: AravisObject | None = None
        self._rows: dict[str, tuple[FeatureName, float]] = {}
        if not features.has(_CHUNK_MODE):
            return
        features.write(_CHUNK_MODE, True)
        purposes = ["chunk exposure", "chunk counter", "chunk timestamp"]
        if features.has(_GAIN):
            purposes.append("chunk gain")
        for purpose in purposes:
            row = next((r for r in names_for(purpose, camera) if _enable(features, r)), None)
            if row is not None:
                _require_within_frame(opened, row.name)
                unit = features.unit_of(row.name) or row.unit
                self._rows[purpose] = (row, US_PER_UNIT.get(unit, 1.0))
        if not self._rows:
            features.write(_CHUNK_MODE, False)
            return
        self._is_float = {
            row.name: features.type_of(row.name) == "float" for row, _ in self._rows.values()
        }
        with translated_errors(opened.library, _CHUNK_MODE):
            self._parser = opened.camera.create_chunk_parser()

    def read(self, buffer: AravisObject) -> _FrameFacts | None:
        """What a complete frame says of itself; None if it lacks what was switched on."""
        if self._rows and not buffer.has_chunks():
            return None
        try:
            exposure = self._number(buffer, "chunk exposure")
            gain = self._number(buffer, "chunk gain")
            counter = self._number(buffer, "chunk counter")
            ticks = self._number(buffer, "chunk timestamp")
        except self._opened.library.glib.Error:
            return None
        return _FrameFacts(
            exposure_us=exposure,
            gain=gain,
            counter=None if counter is None else int(counter),
            timestamp_ticks=None if ticks is None else int(ticks),
        )

    def close(self) -> None:
        """Drop the parser; closing twice is harmless."""
        self._parser = None
        self._rows = {}

    def _number(self, buffer: AravisObject, purpose: str) -> float | None:
        if purpose not in self._rows or self._parser is None:
            return None
        row, scale = self._rows[purpose]
        if self._is_float[row.name]:
            return float(self._parser.get_float_value(buffer, row.name)) * scale
        return int(self._parser.get_integer_value(buffer, row.name)) * round(scale)


def _require_within_frame(opened: OpenedDevice, feature: str) -> None:
    """Refuse a chunk that would be read from memory behind the frame."""
    for node in opened.description.nodes_of(feature):
        if node not in opened.description.in_chunks:
            continue
        with translated_errors(opened.library, feature):
            address = int(opened.device.get_feature(node).get_address())
            length = int(opened.device.get_feature(node).get_length())
        if address + length > _BEYOND_BYTES:
            raise CameraDescriptionError(
                f"the camera says that {feature} lies {address} bytes into its chunk; set "
                "camera.chunk_data to false, or reinstall its maker's firmware",
                fault="register",
                nodes=(feature, node),
            )


def _enable(features: CameraFeatures, row: FeatureName) -> bool:
    """Switch a chunk on; False if the camera does not have it."""
    if not features.is_described(row.name):
        return False
    if not features.has(_CHUNK_SELECTOR):
        return True  # the chunks of such a camera come all together
    entries = features.entries(_CHUNK_SELECTOR)
    entry = next((name for name in row.selector.split(";") if name in entries), None)
    if entry is None:
        return False
    with features.selected(_CHUNK_SELECTOR, entry):
        if features.has(_CHUNK_ENABLE):
            features.write(_CHUNK_ENABLE, True)
    return True


SOCKET_BUFFER_BYTES = 4 * 2**20
"""Room for over four frames of 780x580x2 in the kernel while this program is not scheduled."""

_BUFFERED_S = 0.3
_MIN_BUFFERS, _MAX_BUFFERS = 8, 64
"""Length of the frame queue as a time; the bounds suit slow and fast cameras."""

_ABORT = "AcquisitionAbort"

_LARGEST_IMAGE_BYTES = 1 << 30
_LARGEST_CHUNKS_BYTES = 1 << 20
"""What a frame may have beside its picture, and padding as large as that; memory is taken for
dozens of frames, and a computer without any ends the program."""

_LENT_MOST = 6
"""Images in use before others are copied: an average takes them by fours."""


class FrameStream:
    """A stream channel with its receive thread, and the chunks of each frame, if any."""

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
        self._newest_facts = _FrameFacts()
        self._packets_before = (0, 0)
        # Compiled before the stream runs: the first time takes a second, and no frame waits.
        _decode_pixels(bytes(_encoded_bytes(self._format_name, (1, 2))), self._format_name, (1, 2))
        self._success = library.api.BufferStatus.SUCCESS
        payloads = library.api.BufferPayloadType
        self._image_payload = payloads.IMAGE
        self._chunk_payload = payloads.CHUNK_DATA
        with translated_errors(library, "the stream channel"):
            self._format_code = int(opened.camera.get_pixel_format())
            payload_bytes = int(opened.camera.get_payload())
            image_bytes = _encoded_bytes(self._format_name, self._shape)
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
        wanted = math.ceil(_BUFFERED_S * settings.frame_rate_hz)
        self._memory = _FrameMemory(
            library,
            self._made,
            buffers=min(max(wanted, _MIN_BUFFERS), _MAX_BUFFERS),
            buffer_bytes=payload_bytes,
            image_bytes=image_bytes,
            lent_most=_LENT_MOST,
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
        self._newest_facts = _FrameFacts()  # some cameras count from the start of the series
        with translated_errors(self._opened.library, "AcquisitionStart"):
            self._opened.camera.start_acquisition()

    def stop(self, *, is_exposing_long: bool = False) -> None:
        """Stop; frames that still arrive are dropped at the next start.

        A long exposure is aborted where the camera can: after a mere stop it is finished first.
        """
        camera = self._opened.camera
        if is_exposing_long:
            with translated_errors(self._opened.library, _ABORT):
                if camera.is_feature_available(_ABORT):
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
            data = self._memory.lend(buffer, _encoded_bytes(self._format_name, shape))
            if data is not None:
                self._newest_ns, self._newest_facts = timestamp_ns, facts
                return Frame(
                    image_dn=_decode_pixels(data, self._format_name, shape),
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

        A late packet of an earlier series may be the first that a new thread sees: then it takes
        the blocks of this series for late ones, up to a hundred behind (Aravis 0.8.26).
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

        Close the device only afterwards, and make no other stream of the camera before: its port
        would be cleared (Aravis 0.8.26).
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
    ) -> tuple[tuple[int, int], _FrameFacts] | None:
        """``(rows, cols)`` of a complete picture and what it says of itself; None if it is none."""
        # The state comes first: an incomplete buffer has no picture to ask about.
        if buffer.get_status() != self._success or timestamp_ns <= self._newest_ns:
            return None
        shape = self._shape_of(buffer)
        facts = _FrameFacts() if self._chunks is None else self._chunks.read(buffer)
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

    def _is_newer(self, facts: _FrameFacts) -> bool:
        """Whether the camera's own counter and time stamp say so too, where it states them."""
        before = self._newest_facts
        pairs = (
            (before.counter, facts.counter),
            (before.timestamp_ticks, facts.timestamp_ticks),
        )
        return all(old is None or new is None or new != old for old, new in pairs)


def _require_plausible(payload_bytes: int, image_bytes: int) -> None:
    """Refuse a frame that no memory holds, or that does not hold its picture."""
    if image_bytes > _LARGEST_IMAGE_BYTES:
        raise CameraFeatureError(
            f"a picture of {image_bytes} bytes is too large; set camera.region_px to a smaller one",
            feature="Width",
        )
    if not image_bytes <= payload_bytes <= 2 * image_bytes + _LARGEST_CHUNKS_BYTES:
        raise CameraFeatureError(
            f"the camera states {payload_bytes} bytes for a frame (PayloadSize), but the picture "
            f"in it takes {image_bytes}; restart the camera, or reinstall the firmware",
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
