"""How a JPEG file was coded, so that another photograph can be coded alike."""

from dataclasses import dataclass, field
from io import BytesIO
from typing import Self

import numpy as np
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile, get_sampling

from simulation.arrays import AnyArray

_KNOWN_SAMPLINGS = (0, 1, 2)
"""4:4:4, 4:2:2 and 4:2:0, which Pillow writes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JpegCoding:
    """Tables and sampling of a JPEG file.

    Parameters
    ----------
    tables
        Quantisation tables of its components, 64 steps each, rows by vertical frequency.
    sampling
        Of the chroma: 0 for 4:4:4, 1 for 4:2:2, 2 for 4:2:0; -1 of a grey one.
    """

    tables: tuple[tuple[int, ...], ...] = field(repr=False)
    sampling: int

    @classmethod
    def of(cls, image: Image.Image) -> Self | None:
        """Read it off an image; None where it is another than Pillow writes."""
        if not isinstance(image, JpegImageFile) or image.mode not in ("L", "RGB"):
            return None
        sampling = get_sampling(image)
        if image.mode == "RGB" and sampling not in _KNOWN_SAMPLINGS:
            return None
        tables = tuple(tuple(image.quantization[key]) for key in sorted(image.quantization))
        return cls(tables=tables, sampling=sampling)

    @property
    def coarseness(self) -> int:
        """Sum of the steps of the first table, the luma's."""
        return sum(self.tables[0])

    def of_levels(self, stored: AnyArray) -> AnyArray:
        """Code levels of 8 bits, shape ``(rows, cols)`` or ``(rows, cols, 3)``, and decode them."""
        file = BytesIO()
        how = {"subsampling": self.sampling} if stored.ndim == 3 else {}
        Image.fromarray(np.ascontiguousarray(stored)).save(
            file, "JPEG", qtables=[list(table) for table in self.tables], **how
        )
        return np.asarray(Image.open(BytesIO(file.getvalue())))
