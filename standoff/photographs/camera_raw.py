"""Camera raw files through LibRaw: the mosaic as the sensor delivered it, never developed.

The thumbnail that such a file holds, often as its first image, is not looked at.
"""

from io import BytesIO
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.choices import PATTERNS, Pattern
from standoff.photographs.encoding import LINEAR
from standoff.photographs.exif import PhotographFacts
from standoff.photographs.guard import refuse_giant
from standoff.photographs.stored import DecodingError, StoredImage, decoding
from standoff.photographs.tiff import black_repeat_px

RAW_SUFFIXES = frozenset(
    """.3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .fff .iiq .k25 .kdc .mef .mos .mrw .nef .nrw .orf
    .pef .raf .raw .rw2 .rwl .sr2 .srf .srw .x3f""".split()  # noqa: SIM905 - a list is longer
)
_SIGNATURES = (b"IIU\0", b"IIRO", b"IIRS", b"MMOR", b"FUJIFILMCCD-RAW", b"\0MRM", b"FOVb")
_DNG_VERSION = 50706
_LARGEST_REPEAT_PX = 2  # LibRaw keeps more to itself
_EXTRA = 'install the reader: pip install "standoff[raw]"'


def is_camera_raw(data: bytes, path: PurePath, tiff_tags: frozenset[int]) -> bool:
    """Whether a file is for LibRaw: by its first bytes, its tags, or its suffix.

    Parameters
    ----------
    data
        Of the file.
    path
        Its name.
    tiff_tags
        Numbers of the tags in its first directory; empty where it is no TIFF.
    """
    return (
        data.startswith(_SIGNATURES)
        or data[8:12] == b"CR\x02\0"
        or data[4:12] == b"ftypcrx "
        or _DNG_VERSION in tiff_tags
        or path.suffix.lower() in RAW_SUFFIXES
    )


def read_camera_raw(data: bytes, facts: PhotographFacts) -> StoredImage:
    """Read the mosaic of a camera raw file, with its black level taken off.

    Raises
    ------
    DecodingError
        If LibRaw is not installed, cannot read the file, or the sensor has no Bayer filter.
    """
    try:
        import rawpy
    except ImportError as error:
        raise DecodingError(f"a camera raw file; {_EXTRA}") from error
    if black_repeat_px(data) > _LARGEST_REPEAT_PX:
        raise DecodingError(
            "black levels that differ within more than 2 x 2 pixels are not read; "
            "convert it to a linear TIFF"
        )
    with decoding("camera raw file", rawpy.LibRawError), rawpy.imread(BytesIO(data)) as raw:
        sizes = raw.sizes
        refuse_giant((sizes.raw_height, sizes.raw_width), 2, len(data))
        is_mosaic = raw.raw_type == rawpy.RawType.Flat
        pattern = _pattern(raw) if is_mosaic else None
        # A copy: the array of LibRaw is gone once the file is closed.
        visible = raw.raw_image_visible
        levels = (visible if is_mosaic else visible[..., :3]).astype(np.float32)
        black_dn = _black_levels(raw, is_mosaic=is_mosaic)
        white_dn = float(raw.white_level or 65535)
    levels -= black_dn
    white = white_dn - float(black_dn.max())
    if not white > 0:
        raise DecodingError(f"its white level {white_dn:g} is not above its black level")
    return StoredImage(
        count=1,
        page=lambda _: levels,
        marked=lambda: (LINEAR, "camera raw"),
        facts=facts,
        white_dn=white,
        saturation_dn=white,
        pattern=pattern,
    )


def _pattern(raw: Any) -> Pattern | None:  # noqa: ANN401 - rawpy has no types
    """Colours of the first two by two visible pixels; None for a sensor without colours."""
    if raw.raw_pattern is None or raw.num_colors == 1:
        return None
    cells = raw.raw_colors_visible[:2, :2].ravel()
    found = "".join(chr(raw.color_desc[cell]) for cell in cells)
    if raw.raw_pattern.shape != (2, 2) or found not in PATTERNS:
        raise DecodingError(
            "a raw file whose sensor has no Bayer filter; convert it to a linear TIFF"
        )
    return found


def _black_levels(raw: Any, *, is_mosaic: bool) -> NDArray[np.float32]:  # noqa: ANN401
    levels = np.asarray(raw.black_level_per_channel, dtype=np.float32)
    if not is_mosaic:
        return levels[:3]
    if raw.raw_pattern is None or len(set(levels.tolist())) == 1:
        return levels[:1]
    return np.asarray(levels[raw.raw_colors_visible])
