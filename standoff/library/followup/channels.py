"""A photograph in colour simulated channel by channel, each with a PSF of its own."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from simulation import Psf
from simulation.arrays import AnyArray
from simulation.followup import FollowUp


def each_channel(
    reference: AnyArray, psfs: Sequence[Psf], made: Callable[[AnyArray, Psf], FollowUp]
) -> FollowUp:
    """Return the follow-up of a photograph whose channels have a PSF each.

    Its masks and its form of the PSF are those of the second channel, green.

    Parameters
    ----------
    reference
        Shape ``(rows, cols, channels)``.
    psfs
        One for each channel.
    made
        Makes the follow-up of one channel, shape ``(rows, cols)``, with its PSF.
    """
    planes = [
        made(np.ascontiguousarray(reference[:, :, channel]), psf)
        for channel, psf in enumerate(psfs)
    ]
    variances = [one.own_variance_dn2 for one in planes if one.own_variance_dn2 is not None]
    return replace(
        planes[1],
        image=np.stack([one.image for one in planes], axis=2),
        own_variance_dn2=np.stack(variances, axis=2) if variances else None,
    )
