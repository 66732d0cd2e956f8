"""The chain of directories in a TIFF, walked before a library believes what they say.

TIFF 6.0, section 2; BigTIFF (Aware Systems, 2011). A file of a megabyte can hold thousands of
directories whose tags all point at the same megabyte.
"""

import struct
from dataclasses import dataclass

from standoff.photographs.stored import DecodingError

MOST_PAGES = 10_000
_SMALL_BYTES = 16 << 20
_LARGEST_RATIO = 8  # of all values of tags to the file
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4,
               16: 8, 17: 8, 18: 8}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layout:
    """The numbers of a directory: its count, one entry, and the offset of the next."""

    count: struct.Struct
    entry: struct.Struct
    next: struct.Struct
    first_at: int


def refuse_overlapping_directories(data: bytes) -> None:
    """Check the number of pages, and that their tags are not far larger than the file.

    Raises
    ------
    DecodingError
        If they are, or there are more than ``MOST_PAGES``.
    struct.error
        If the file ends within a directory.
    """
    layout = _layout(data)
    (at,) = layout.next.unpack_from(data, layout.first_at)
    values_bytes = pages = 0
    while at and at < len(data):
        pages += 1
        if pages > MOST_PAGES:
            raise DecodingError(f"a TIFF of more than {MOST_PAGES} pages")
        (entries,) = layout.count.unpack_from(data, at)
        at += layout.count.size
        end = at + entries * layout.entry.size
        for _, kind, count in layout.entry.iter_unpack(data[at:end]):
            values_bytes += min(count * _TYPE_BYTES.get(kind, 1), len(data))
        if values_bytes > max(_SMALL_BYTES, _LARGEST_RATIO * len(data)):
            raise DecodingError("a TIFF whose tags say more than the file can hold")
        (at,) = layout.next.unpack_from(data, end)


def _layout(data: bytes) -> _Layout:
    order = "<" if data[:2] == b"II" else ">"
    if data[2:4] in (b"+\0", b"\0+"):
        return _Layout(
            count=struct.Struct(f"{order}Q"),
            entry=struct.Struct(f"{order}HHQ8x"),
            next=struct.Struct(f"{order}Q"),
            first_at=8,
        )
    return _Layout(
        count=struct.Struct(f"{order}H"),
        entry=struct.Struct(f"{order}HHI4x"),
        next=struct.Struct(f"{order}I"),
        first_at=4,
    )
