"""Two files that hold the same levels, of which one does not say how they are encoded."""

import numpy as np

from acquisition.photographs import Photograph, luma_plane
from simulation.arrays import FloatArray

_AS_MUCH_NEARER = 4.0
"""How much nearer than the decoded levels the stored ones of a copy are. Of nine of scikit-image's
pictures, each beside another one, they are 2.5 times as near at most."""


def decoded_alike(
    near: Photograph, far: Photograph
) -> tuple[Photograph, Photograph, tuple[str, ...]]:
    """The photographs, of which one that says no encoding is taken as the other it is a copy of.

    A TIFF of 8 bits is linear where nothing is said, a PNG is sRGB: of one picture saved as both
    the light would differ at every level.

    Parameters
    ----------
    near, far
        As they were read.

    Returns
    -------
    Both, and a sentence where an encoding was taken over.
    """
    if near.encoding.name == far.encoding.name or near.stored.shape[:2] != far.stored.shape[:2]:
        return near, far, ()
    if near.is_encoding_stated and far.is_encoding_stated:
        return near, far, ()
    if near.pattern is not None or far.pattern is not None:
        return near, far, ()
    stored, decoded = (
        float(np.sqrt(np.mean(np.square(one - other))))
        for one, other in ((_stored(near), _stored(far)), (_decoded(near), _decoded(far)))
    )
    if not stored * _AS_MUCH_NEARER < decoded:
        return near, far, ()
    # Of two that say nothing, the one whose kind of file is usually of a picture for the screen.
    is_near = far.is_encoding_stated or (near.encoding.is_linear and not near.is_encoding_stated)
    copy, other = (near, far) if is_near else (far, near)
    if len(other.encoding.curves) > 1 and not copy.is_colour:
        return near, far, ()
    said = (
        f"{copy.name} does not say how its levels are encoded and holds those of {other.name}: "
        f"taken as {other.encoding.name}, as that one is"
    )
    taken = copy.taken_as(other.encoding, f"as {other.name}")
    return (taken, far, (said,)) if is_near else (near, taken, (said,))


def _stored(photograph: Photograph) -> FloatArray:
    return np.asarray(luma_plane(photograph.stored) / photograph.white_dn)


def _decoded(photograph: Photograph) -> FloatArray:
    return np.asarray(photograph.grey_dn / photograph.white_dn)
