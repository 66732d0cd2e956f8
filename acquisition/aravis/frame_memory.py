"""Memory that Aravis receives frames into, and that images are read from without a copy."""

import ctypes
import weakref

from acquisition.aravis.library import AravisLibrary, AravisObject

SENTINEL = bytes.fromhex("a5 3c f1 0e 96 69 d2 5b b4 87 e8 1d c3 7a 2f 50")
"""Laid at an image's end before its buffer is filled: still there, the image came too short."""

BEYOND_BYTES = 4096
"""Memory after each buffer: a register in a chunk may lie behind the end of what came, and Aravis
0.8.26 reads it there all the same."""


class FrameMemory:
    """The buffers of one stream.

    An image is read where it was received. Its buffer goes back to the stream when nothing refers
    to the image any more; a program that keeps images gets copies once ``lent_most`` are in use.

    Parameters
    ----------
    library
        Aravis.
    stream
        The stream; it gets all the buffers.
    buffers
        How many wait for frames at any time.
    buffer_bytes
        Size of each: image, chunks and padding.
    image_bytes
        What an image of the size that was set takes, at the buffer's begin.
    lent_most
        How many images may be in use beside the buffers that wait.
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
            block = (ctypes.c_uint8 * (buffer_bytes + BEYOND_BYTES))()
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
        """The bytes of a complete image, read-only, or None if they are too few.

        The buffer goes back by itself: when the bytes are no longer used, or at once.
        """
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
