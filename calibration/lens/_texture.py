"""What dead leaves tell, as part of a lens.json, beside the edges of the same photograph."""

from collections.abc import Sequence
from math import hypot, sqrt

import numpy as np
from scipy.stats import norm, t as student_t

from acquisition.files import StoredModel
from calibration.edges import NEARLY_SATURATED, EdgeImage, EdgeMeasurement
from calibration.lens._targets import crossings
from calibration.sharpness import (
    EdgeFigures,
    MeasuredValue,
    TextureSfr,
    find_dead_leaves,
    measure_dead_leaves,
    spread_of,
)
from simulation.arrays import BoolArray, FloatArray

_FEWEST_EDGES = 3
_FAINT = 0.2
_KEPT, _SURE = 0.95, 3.0  # below this ratio, by so many standard errors, texture is lost
_MOST = 1.03  # above this ratio, as surely, the picture may be coarser than the print
_CHANCE = 0.025


class TextureFigures(StoredModel):
    """Contrast by frequency of dead leaves, by the intrinsic and by the direct method.

    ``figures`` are of the intrinsic curve; the direct one is None where the photograph shows no
    edges, whose noise it takes off. ``over_edges`` is the area under the intrinsic curve over that
    under the edges' of the same photograph, as far as these have a fifth of their contrast;
    ``is_lost`` and ``is_beyond_edges`` say whether it is below or above 1 by more than chance.
    """

    image: str
    x_px: float
    y_px: float
    tiles: int
    freq_cy_per_px: tuple[float, ...]
    intrinsic: tuple[float, ...]
    intrinsic_err: tuple[float, ...]
    direct: tuple[float, ...] | None = None
    direct_err: tuple[float, ...] | None = None
    figures: EdgeFigures
    direct_figures: EdgeFigures | None = None
    over_edges: MeasuredValue | None = None
    is_lost: bool = False
    is_beyond_edges: bool = False

    @property
    def sentence(self) -> str:
        """What the comparison with the edges says."""
        if self.over_edges is None:
            return "Without edges in the same photograph there is nothing to compare texture with."
        kept = f"{self.over_edges.estimate.text(3)} of the area under the edges' curve"
        if self.is_lost:
            return (
                f"Texture loses contrast that edges keep ({kept}), as after noise reduction, or "
                "where the lens is less sharp at the target than at the edges."
            )
        if self.is_beyond_edges:
            return (
                f"Texture has more contrast than edges: {kept}. If the picture given is coarser "
                "than what was printed, these figures are wrong; a lens that is sharper at the "
                "target than at the edges looks the same."
            )
        return f"No sign that texture is lost: {kept}."


def texture_figures(
    image: EdgeImage, target: FloatArray, edges: Sequence[EdgeMeasurement]
) -> TextureFigures | None:
    """Find and measure dead leaves of a known picture; None if the photograph does not show them.

    Parts of the target that are clipped or masked do not count. ``target`` is linear in light,
    ``edges`` are those of the same photograph that are used, which may be none.
    """
    matrix = find_dead_leaves(image.image_dn, target)
    if matrix is None:
        return None
    found = measure_dead_leaves(
        image.image_dn, target, matrix, _noise_dn(edges), _not_measured(image)
    )
    if found is None:
        return None
    freq = found.freq_cy_per_px
    over_edges = _over_edges(found, edges)
    direct, direct_err = found.direct, found.direct_err
    return TextureFigures(
        image=image.name,
        x_px=found.x_px,
        y_px=found.y_px,
        tiles=found.tiles,
        freq_cy_per_px=tuple(freq.tolist()),
        intrinsic=tuple(found.intrinsic.tolist()),
        intrinsic_err=tuple(found.intrinsic_err.tolist()),
        direct=None if direct is None else tuple(direct.tolist()),
        direct_err=None if direct_err is None else tuple(direct_err.tolist()),
        figures=_figures(found),
        direct_figures=None
        if direct is None or direct_err is None
        else crossings(freq, direct, direct_err, found.scale_err),
        over_edges=over_edges,
        is_lost=over_edges is not None
        and over_edges.value < min(_KEPT, 1 - _SURE * over_edges.err),
        is_beyond_edges=over_edges is not None
        and over_edges.value > max(_MOST, 1 + _SURE * over_edges.err),
    )


def _not_measured(image: EdgeImage) -> BoolArray:
    """Pixels that are clipped or masked."""
    levels_dn = image.image_dn
    found = np.zeros(levels_dn.shape, np.bool_) if image.clipped is None else image.clipped.copy()
    if image.saturation_dn is not None:
        found |= levels_dn >= NEARLY_SATURATED * image.saturation_dn
        if levels_dn.min() >= 0:  # else a dark level was taken off, and 0 is no bound
            found |= levels_dn == 0
    if image.masked is not None:
        found |= image.masked
    return found


def _figures(found: TextureSfr) -> EdgeFigures:
    """Where the intrinsic curve falls to a half and so on, with errors by the jackknife."""
    curve = found.freq_cy_per_px, found.intrinsic, found.intrinsic_err
    whole, exact = (crossings(*curve, scale_err) for scale_err in (found.scale_err, 0.0))
    fewer = [crossings(curve[0], one, curve[2], 0.0) for one in found.without]
    known = {}
    for name, value in whole:
        if not isinstance(value, MeasuredValue):
            continue
        of_fewer = [getattr(one, name) for one in fewer]
        if all(of_fewer):
            by_scale2 = value.err**2 - getattr(exact, name).err ** 2
            by_noise = float(spread_of(np.array([one.value for one in of_fewer])))
            known[name] = MeasuredValue(value=value.value, err=sqrt(by_noise**2 + by_scale2))
    return EdgeFigures.model_validate(known)


def _noise_dn(edges: Sequence[EdgeMeasurement]) -> float | None:
    """Noise of a pixel beside the edges, at the mean of their levels."""
    known = [
        abs(edge.levels_dn[1] - edge.levels_dn[0]) / edge.snr
        for edge in edges
        if edge.levels_dn is not None and edge.snr
    ]
    return float(np.median(known)) if known else None


def _over_edges(found: TextureSfr, edges: Sequence[EdgeMeasurement]) -> MeasuredValue | None:
    """Area under the texture's curve over that under the edges', with its standard error.

    Where the target lies, the lens is as sharp as somewhere among the edges: the error is that of
    one more edge, by Student's t of their scatter as if it were normal.
    """
    curves = [edge.esfr for edge in edges if edge.esfr is not None]
    if len(curves) < _FEWEST_EDGES:
        return None
    values = np.array([one.transform(found.freq_cy_per_px).real for one in curves])
    below = np.median(values, axis=0) < _FAINT
    end = int(np.argmax(below)) if below.any() else below.size
    if end < 2:
        return None
    areas = values[:, :end].sum(axis=1)
    area, middle = float(found.intrinsic[:end].sum()), float(np.median(areas))
    count = len(areas)
    wider = float(student_t.isf(_CHANCE, count - 1) / norm.isf(_CHANCE)) * sqrt(1 + 1 / count)
    by_edges = wider * float(np.std(areas, ddof=1)) / middle
    by_texture = float(spread_of(found.without[:, :end].sum(axis=1))) / area
    ratio = area / middle
    return MeasuredValue(value=ratio, err=ratio * hypot(by_edges, by_texture, found.scale_err))
