"""A description in a zip archive, unpacked with a limit; the entry is the one that Aravis takes.

References
----------
PKWARE, .ZIP File Format Specification (APPNOTE.TXT), version 6.3.10, sections 4.3 and 4.4.
"""

import struct
import zlib

from acquisition.aravis.description.nodes import LARGEST_BYTES, DescriptionError

END, ENTRY, FILE = b"PK\x05\x06", b"PK\x01\x02", b"PK\x03\x04"
END_BYTES, ENTRY_BYTES, FILE_BYTES = 22, 46, 30


def unpack(data: bytes) -> bytes:
    """Return the last file of an archive.

    Raises
    ------
    DescriptionError
        If the archive is damaged, or the file is larger than any description.
    """
    try:
        return _last_file(data)
    except (struct.error, zlib.error) as error:
        raise _damaged() from error


def _last_file(data: bytes) -> bytes:
    end = data.rfind(END)
    if end < 0:
        raise _damaged()
    files, directory_bytes, directory = struct.unpack_from("<HII", data, end + 10)
    # What lies before the archive shifts all its places.
    shift = end - directory_bytes - directory
    place = directory + shift
    packed_bytes = unpacked_bytes = start = -1
    for _ in range(files):
        if place < 0 or data[place : place + 4] != ENTRY:
            raise _damaged()
        packed_bytes, unpacked_bytes = struct.unpack_from("<II", data, place + 20)
        lengths = struct.unpack_from("<HHH", data, place + 28)
        (start,) = struct.unpack_from("<I", data, place + 42)
        place += ENTRY_BYTES + sum(lengths)
    if unpacked_bytes > LARGEST_BYTES:
        raise DescriptionError(
            f"unpacks to {unpacked_bytes} bytes; at most {LARGEST_BYTES} are read",
            fault="too large",
        )
    start += shift
    if files == 0 or start < 0 or data[start : start + 4] != FILE:
        raise _damaged()
    start += FILE_BYTES + sum(struct.unpack_from("<HH", data, start + 26))
    packed = data[start : start + packed_bytes]
    if len(packed) < packed_bytes:
        raise _damaged()
    if packed_bytes < unpacked_bytes:  # otherwise it is only stored
        unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
        packed = unpacker.decompress(packed, unpacked_bytes + 1)
    if len(packed) != unpacked_bytes:
        raise _damaged()
    return packed


def _damaged() -> DescriptionError:
    return DescriptionError("is in a damaged zip archive", fault="packed")
