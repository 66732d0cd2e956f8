"""From the pixels of an image file to one plane that is linear in light."""

import numpy as np

from calibration.choices import Channel
from simulation.arrays import AnyArray, FloatArray

REC601_LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601-7, section 2.5.1


def luma_plane(image: AnyArray, channel: Channel = "luma") -> FloatArray:
    """Return one float64 plane of a grey or colour image.

    Parameters
    ----------
    image
        Shape ``(rows, cols)``, or ``(rows, cols, 1 to 4)``: grey or red, green, blue, then
        optionally an alpha channel, which is ignored.
    channel
        ``luma`` weights red, green and blue by Rec. 601; a grey image has only luma.

    Raises
    ------
    ValueError
        If the shape is neither, or a colour channel of a grey image is requested.
    """
    plane = np.asarray(image)
    if plane.ndim == 3 and plane.shape[2] in (1, 2):
        plane = plane[:, :, 0]
    if plane.ndim == 2:
        if channel != "luma":
            raise ValueError(f"a grey image has no {channel} channel")
        return plane.astype(np.float64)
    if plane.ndim != 3 or plane.shape[2] not in (3, 4):
        raise ValueError(f"an image has shape (rows, cols) or (rows, cols, 3), got {plane.shape}")
    colours = plane[:, :, :3].astype(np.float64)
    if channel == "luma":
        return np.asarray(colours @ np.array(REC601_LUMA))
    return np.asarray(colours[:, :, ("red", "green", "blue").index(channel)])
