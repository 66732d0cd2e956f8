"""The pairs of one photograph as the bytes of image files."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.photographs import tiff_bytes
from acquisition.printable import beginning_of
from analysis.sr_dataset.photograph import PairPhotograph
from analysis.sr_dataset.png_file import png_bytes
from analysis.sr_dataset.settings import SrDatasetSettings
from simulation.zoom import SrPair, sr_pairs

_LONGEST_STEM_BYTES = 180
"""With the digest, the number and what a file has until it is whole, a name has 255 at most."""

_PNG_BYTES_MOST = 2
"""Of a sample; PNG specification, third edition, 11.2.1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EncodedPair:
    """Both images of a pair as files, in the photograph's own encoding.

    ``key`` is unique in a dataset: the digest distinguishes photographs with the same name from
    different folders. ``suffix`` is that of both files: ``.png`` or ``.tif``.
    """

    key: str
    suffix: str
    top_px: int
    left_px: int
    high: bytes = field(repr=False)
    low: bytes = field(repr=False)


def encoded_pairs(photograph: PairPhotograph, settings: SrDatasetSettings) -> Iterator[EncodedPair]:
    """Yield the pairs of a photograph, row by row.

    Raises
    ------
    ValueError
        If it is too small for a crop.
    """
    pairs = sr_pairs(
        photograph.linear,
        settings.zoom,
        settings.psf_of(photograph.linear),
        crop_px=settings.crop_px,
        stride_px=settings.stride_px,
        model=settings.model,
        threads=settings.threads,
    )
    stored: np.dtype[Any] = photograph.stored.dtype
    is_float = settings.is_float or stored.kind != "u" or stored.itemsize > _PNG_BYTES_MOST
    stem = beginning_of(photograph.path.stem, _LONGEST_STEM_BYTES)
    for number, pair in enumerate(pairs):
        high = _stored_crop(photograph, pair, settings.crop_px)
        low = photograph.encode(pair.low)
        if is_float:
            files = tuple(tiff_bytes(image.astype(np.float32), "") for image in (high, low))
        else:
            levels = np.clip(np.rint(low), 0, np.iinfo(stored).max).astype(stored)
            files = tuple(photograph.marked(png_bytes(image)) for image in (high, levels))
        yield EncodedPair(
            key=f"{stem}_{photograph.sha256[:8]}_{number:05d}",
            suffix=".tif" if is_float else ".png",
            top_px=pair.top_px,
            left_px=pair.left_px,
            high=files[0],
            low=files[1],
        )


def _stored_crop(photograph: PairPhotograph, pair: SrPair, crop_px: int) -> NDArray[Any]:
    """The levels of a crop as the file has them: to light and back they would be the same."""
    top_px, left_px = pair.top_px, pair.left_px
    return photograph.stored[top_px : top_px + crop_px, left_px : left_px + crop_px]
