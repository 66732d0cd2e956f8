"""The lens of two photographs at two distances, and how sure it is."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from benchmarks.lens_between.cosine_blocks import before_rounding
from benchmarks.lens_between.lens_estimate import LensEstimate, lens_of
from benchmarks.lens_between.lens_prior import GAUSSIAN_PARAMETERS, lens_prior
from benchmarks.lens_between.resampled_pair import Alignment, resampled
from benchmarks.lens_between.transfer import LensFit, PairModel
from calibration.blind.two_distance import align_smoothly
from calibration.edges import JpegCompression
from calibration.errors import PairError
from simulation.arrays import FloatArray

_SHARPEST_PX2 = 0.03  # the pixel alone has 1/12
_FEWEST_BLOCKS = 100


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NearAndFar:
    """Two photographs of a scene; what is not known is None.

    ``near_noise_dn2`` is the noise of a near pixel, ``near_codes`` and ``far_codes`` say how the
    files were compressed.
    """

    near_dn: FloatArray
    far_dn: FloatArray
    near_noise_dn2: float | None = None
    near_codes: JpegCompression | None = None
    far_codes: JpegCompression | None = None


def lens_between(pair: NearAndFar, far_to_near: FloatArray) -> LensEstimate:
    """Lens and pixel from a near and a far photograph, and a homography right to a few px."""
    if pair.near_codes is not None:
        pair = replace(pair, near_dn=before_rounding(pair.near_dn, pair.near_codes))
    found = align_smoothly(pair.near_dn, pair.far_dn, far_to_near)
    alignment = Alignment(y_px=found.y_px, x_px=found.x_px, jacobian=found.jacobian)
    first = _model(pair, alignment)
    gaussian = first.fitted(first.start(lens_prior().mean), is_gaussian=True)
    (xx, xy, yy) = gaussian.lens[:GAUSSIAN_PARAMETERS] + np.array([1.0, 0.0, 1.0]) / 12
    if np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] < _SHARPEST_PX2:
        raise PairError("the far photograph is not softer than the near one", reason="sharp")
    # The first fit's displacement is linear in the pixels, which blurs: they are resampled by it.
    second = _model(pair, _moved(alignment, first, gaussian))
    fit = second.fitted(second.start(gaussian.lens))
    noise_dn2 = pair.near_noise_dn2
    if noise_dn2 is None:
        noise_dn2 = second.found_noise_dn2(fit)
    return lens_of([second.with_true_share(fit, noise_dn2).fitted(fit)])


def _model(pair: NearAndFar, alignment: Alignment) -> PairModel:
    """The model of aligned photographs; their blocks are those of the far file."""
    codes = pair.far_codes
    first = (0, 0) if codes is None else (codes.first_row, codes.first_col)
    model = PairModel(
        resampled(pair.near_dn, pair.far_dn, alignment, first),
        pair.near_noise_dn2 or 0.0,
        codes,
    )
    if model.blocks < _FEWEST_BLOCKS:
        raise PairError("the photographs hardly overlap", reason="little_overlap")
    return model


def _moved(alignment: Alignment, model: PairModel, fit: LensFit) -> Alignment:
    """The alignment with the displacement that a fit has found."""
    pair, shape = model.pair, alignment.y_px.shape
    place = np.mgrid[: shape[0], : shape[1]] - np.array([pair.top, pair.left])[:, None, None]
    x, y = (
        map_coordinates(field, place, order=1, mode="nearest") for field in model.displacement(fit)
    )
    (xx, xy), (yx, yy) = pair.near_per_far
    return replace(
        alignment,
        x_px=alignment.x_px + xx * x + xy * y,
        y_px=alignment.y_px + yx * x + yy * y,
    )
