"""Photographs in colour as a screen shows them."""

import numpy as np

from simulation.arrays import AnyArray, FloatArray

_WHITE_PERCENT = 99.8
"""Of the pixels' brightest channels: few lose their hue at white, and no hot pixel darkens all."""


def on_screen(colours_dn: AnyArray, white_dn: float) -> FloatArray:
    """Return colours as a screen takes them: the sRGB curve of each channel, from 0 to 1.

    Black is a level of 0 and white is the same level in all channels, so that ratios of the
    channels, and with them hues, are those of the photograph.

    Parameters
    ----------
    colours_dn
        Red, green and blue, shape ``(rows, cols, 3)``, linear in light; NaN stays NaN.
    white_dn
        Level of white, positive.
    """
    share = np.asarray(colours_dn, dtype=np.float64) / white_dn
    return linear_to_srgb(np.clip(share, 0.0, 1.0))


def white_level_dn(colours_dn: AnyArray) -> float:
    """Return the level to show as white: that of the brightest channel of all but few pixels.

    Parameters
    ----------
    colours_dn
        Shape ``(..., 3)``, linear in light, not empty.
    """
    brightest = np.asarray(colours_dn).max(axis=-1)
    return max(float(np.percentile(brightest, _WHITE_PERCENT)), 1e-9)


def linear_to_srgb(linear: FloatArray) -> FloatArray:
    """IEC 61966-2-1:1999, section 5.3, from 0 to 1."""
    threshold = 0.04045 / 12.92
    power = 1.055 * np.maximum(linear, threshold) ** (1 / 2.4) - 0.055
    return np.where(linear <= threshold, linear * 12.92, power)
