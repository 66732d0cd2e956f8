"""The two images that a change detector compares, as linear operators on the scene image c.

``c' = A_r c`` is the reference, ``c'' = A_rz c`` the follow-up from ``z`` times further away, both
simulated from c by the model under test; ``U`` brings the follow-up onto the reference's pixels.
``docs/theory-detectability.md`` has the definitions.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, sqrt

import numpy as np

from analysis.choices import REFERENCE_ZOOM
from simulation import Model, Psf, SamplingGrid, ZoomOperator, zoom_operator
from simulation.arrays import FloatArray
from simulation.resampling import BandedMatrix, antialiased_cubic, apply_separable

_CUBIC_REACH_PX = 2
"""Follow-up pixels that the cubic takes on either side."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ComparedPair:
    """Reference and follow-up of one scene image, without noise.

    Parameters
    ----------
    reference, followup
        From c to c' and to c''.
    reference_grid
        Pixels of c' in c.
    up_y, up_x
        Bicubic upscaling ``U`` from c'' onto c', along rows and columns.
    zoom
        Ratio of the two distances.
    """

    reference: ZoomOperator
    followup: ZoomOperator
    reference_grid: SamplingGrid
    up_y: BandedMatrix
    up_x: BandedMatrix
    zoom: float

    def reference_of(self, scene: FloatArray) -> FloatArray:
        """Reference image c' of a scene image."""
        return np.asarray(self.reference.apply(scene), dtype=np.float64)

    def aligned_of(self, scene: FloatArray) -> FloatArray:
        """Follow-up of a scene image on the pixels of c'; of a signal, what is left of it."""
        return self.upscaled(np.asarray(self.followup.apply(scene), dtype=np.float64))

    def upscaled(self, followup: FloatArray) -> FloatArray:
        """An image on the follow-up's pixels, brought onto those of c'."""
        return np.asarray(apply_separable(self.up_y, self.up_x, followup), dtype=np.float64)

    def artefact_of(self, scene: FloatArray) -> FloatArray:
        """Difference that the pose alone makes, ``U c'' - c'``, where U needs no border.

        Raises
        ------
        ValueError
            If nothing is left within the border.
        """
        difference = self.within_border(self.aligned_of(scene) - self.reference_of(scene))
        if difference.size == 0:
            raise ValueError(f"an image of {scene.shape} is too small for zoom {self.zoom:g}")
        return difference

    def within_border(self, image: FloatArray) -> FloatArray:
        """Cut an image on the pixels of c' to where U needs no border."""
        margin = ceil(_CUBIC_REACH_PX * self.zoom) + 1
        return image[margin:-margin, margin:-margin]


@lru_cache(maxsize=64)
def compared_pair(
    shape: tuple[int, int],
    psf: Psf | None,
    model: Model,
    zoom: float,
    reference_zoom: float = REFERENCE_ZOOM,
) -> ComparedPair:
    """Operators for scene images of one size; cached.

    Parameters
    ----------
    shape
        ``(rows, cols)`` of c.
    psf
        Total PSF of c; ``bicubic`` needs none.
    model
        The model under test, for both zooms.
    zoom
        Ratio of the follow-up's distance to the reference's, at least 1.
    reference_zoom
        Ratio of the reference's distance to that of c, at least 1.

    Raises
    ------
    ValueError
        If a zoom is below 1 or leaves no pixel, or the PSF is missing.
    """
    near = SamplingGrid.centred(shape, reference_zoom)
    far = SamplingGrid.centred(shape, reference_zoom * zoom)
    return ComparedPair(
        reference=zoom_operator(shape, near, psf, model),
        followup=zoom_operator(shape, far, psf, model),
        reference_grid=near,
        up_y=_upscaling(near.rows_px, far.rows_px, far.zoom_y),
        up_x=_upscaling(near.cols_px, far.cols_px, far.zoom_x),
        zoom=zoom,
    )


def frame_size_px(
    psf: Psf | None, signal_px: float, window_px: int, zoom: float, reference_zoom: float
) -> int:
    """Side of a square scene image in which a signal near the middle meets no border.

    Parameters
    ----------
    psf
        Total PSF of c.
    signal_px
        Distance from the middle that the signal reaches, in px of c.
    window_px
        Side of the window on c' that is looked at.
    zoom, reference_zoom
        As in ``compared_pair``.
    """
    total = reference_zoom * zoom
    sigma_px = 0.0 if psf is None else sqrt(float(np.trace(psf.covariance_px2)))
    blur_px = 6.0 * sigma_px * sqrt(max(total**2 - 1, 0.0))
    reach = reference_zoom * window_px / 2 + signal_px + blur_px + 8 * total
    return 2 * ceil(reach) + 1


def _upscaling(near_px: FloatArray, far_px: FloatArray, far_zoom: float) -> BandedMatrix:
    """Keys' cubic through the follow-up's pixels, at the positions of the reference's."""
    # Rounded, so that coinciding pixels are taken over exactly.
    places = np.round((near_px - far_px[0]) / far_zoom, 9)
    places = np.clip(places, -0.5, len(far_px) - 0.5)
    return antialiased_cubic(places, 1.0, len(far_px))
