"""What a format's reader gives: pixels as stored, and what the file says of them."""

import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray
from PIL import Image, ImageFile

from calibration.choices import Pattern
from simulation.arrays import FloatArray
from standoff.photographs.encoding import LINEAR, Encoding
from standoff.photographs.exif import PhotographFacts
from standoff.photographs.jpeg_coding import JpegCoding


class DecodingError(ValueError):
    """A file is damaged or of a kind that is not read; the message lacks the file's name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredImage:
    """The pixels of one image or of each page of a stack, before any decoding of levels.

    Parameters
    ----------
    count
        Images in the file.
    page
        Reads one of them, from 0, shape ``(rows, cols)`` or ``(rows, cols, channels)``.
    marked
        Gives the encoding that the file states, with where it does; None where it states none.
        Raises DecodingError where it cannot be read, which does not matter if nobody asks.
    unmarked
        Encoding of such files where nothing is stated, with the kind of file as text.
    white_dn
        Level of white; None for floating-point levels.
    saturation_dn
        Level at which the sensor clips, where the file states it.
    pattern
        Colours of a raw mosaic.
    luma_steps
        Of a JPEG, the quantisation table of its luma, shape ``(8, 8)``, rows by vertical frequency;
        None where the levels are no luma compressed as that.
    jpeg_coding
        How a JPEG was coded, if another one can be coded alike.
    variance_dn2, frames
        Of a capture of a session: temporal variance of a frame, and the frames in the mean.
    has_modelled_variance
        Whether that variance is the noise model's, as of an exposure bracket, and not a sample's.
    has_opacity
        Whether a plane beside grey or colours is their opacity, and no light.
    left_out
        What else the file holds and its pages do not, in words.
    """

    count: int
    page: Callable[[int], NDArray[Any]] = field(repr=False)
    marked: Callable[[], tuple[Encoding, str] | None] = field(default=lambda: None, repr=False)
    unmarked: tuple[Encoding, str] = (LINEAR, "")
    facts: PhotographFacts = field(default_factory=PhotographFacts)
    is_jpeg: bool = False
    luma_steps: FloatArray | None = field(default=None, repr=False)
    jpeg_coding: JpegCoding | None = None
    white_dn: float | None = None
    saturation_dn: float | None = None
    pattern: Pattern | None = None
    variance_dn2: FloatArray | None = field(default=None, repr=False)
    frames: int = 1
    has_modelled_variance: bool = False
    has_opacity: bool = False
    left_out: str = ""


_DAMAGE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
    Image.DecompressionBombError,
)
_OF_CODE = (AssertionError, AttributeError, LookupError, TypeError)
"""What a library's code stumbles over: its words are about arrays and names, not about a file."""


@contextmanager
def decoding(kind: str, *damage: type[Exception]) -> Iterator[None]:
    """Name the file's damage, whatever a library raises over it; found by fuzzing.

    Parameters
    ----------
    kind
        What the file should be, as a noun.
    damage
        The library's own errors.

    Raises
    ------
    DecodingError
        In place of any of them.
    """
    fills_what_is_missing = ImageFile.LOAD_TRUNCATED_IMAGES
    ImageFile.LOAD_TRUNCATED_IMAGES = False  # WeasyPrint sets it for the whole process
    try:
        with warnings.catch_warnings():
            # A library warns of damage that it can live with, and of sizes, which are checked here.
            warnings.simplefilter("ignore")
            yield
    except DecodingError:
        raise
    except _DAMAGE + damage as error:
        said = "" if isinstance(error, _OF_CODE) else str(error)
        cause = f": {said.splitlines()[0][:120]}" if said else ""
        raise DecodingError(f"not a complete {kind}{cause}") from error
    finally:
        ImageFile.LOAD_TRUNCATED_IMAGES = fills_what_is_missing
