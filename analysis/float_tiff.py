"""Images of floating-point levels as the bytes of TIFF files."""

from io import BytesIO

import numpy as np
import tifffile

from simulation.arrays import Float32Array


def tiff_bytes(image: Float32Array, description: str) -> bytes:
    """Return a float32 TIFF, grey or RGB, as the bytes of its file."""
    buffer = BytesIO()
    tifffile.imwrite(
        buffer,
        np.ascontiguousarray(image, dtype=np.float32),
        photometric="rgb" if image.ndim == 3 else "minisblack",
        # TIFF has no other letters, though names of files do.
        description=description.encode("ascii", "backslashreplace").decode("ascii"),
        metadata=None,
    )
    return buffer.getvalue()
