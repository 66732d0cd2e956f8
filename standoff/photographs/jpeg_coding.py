"""How a JPEG file was coded, so that another photograph can be coded alike."""

from dataclasses import dataclass, field
from io import BytesIO
from typing import Self

import numpy as np
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile, get_sampling

from simulation.arrays import AnyArray, FloatArray

_KNOWN_SAMPLINGS = (0, 1, 2)
"""4:4:4, 4:2:2 and 4:2:0, which Pillow writes."""

FROM_CHROMA = np.array([[0.0, 1.402], [-0.344136, -0.714136], [1.772, 0.0]])
"""Red, green and blue by blue and red chroma: ITU-T T.871 (2011), section 7."""

_SIZE = 8
"""Of a block of coefficients."""


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
    def chroma_steps(self) -> FloatArray:
        """Table of the chroma, shape ``(8, 8)``; that of the luma where there is no other."""
        return np.array(self.tables[min(1, len(self.tables) - 1)], np.float64).reshape(_SIZE, _SIZE)

    @property
    def halved(self) -> tuple[bool, bool]:
        """Whether the chroma has half the rows, and half the columns."""
        return self.sampling == _KNOWN_SAMPLINGS[2], self.sampling in _KNOWN_SAMPLINGS[1:]

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


def coded_variance(steps: FloatArray, halved: tuple[bool, bool] = (False, False)) -> float:
    """Variance of white noise as large as the coefficients' errors are, behind a Gaussian of 1 px.

    Parameters
    ----------
    steps
        Quantisation table, shape ``(8, 8)``, rows by vertical frequency: each gives the density of
        the error at its frequency.
    halved
        Whether the plane has half the rows, and half the columns: its errors then lie at half the
        frequencies, twice as dense.
    """
    density = np.square(np.asarray(steps, dtype=np.float64)) / 12
    weight = np.ones((1, 1))
    for is_half in halved:
        frequency = np.arange(_SIZE) / (2 * _SIZE) / (2 if is_half else 1)
        weight = np.multiply.outer(weight, np.exp(-((2 * np.pi * frequency) ** 2)))
    weight = weight.reshape(_SIZE, _SIZE)
    whole = np.exp(-((2 * np.pi * np.arange(_SIZE) / (2 * _SIZE)) ** 2))
    return float((density * weight).sum() / np.outer(whole, whole).sum())
