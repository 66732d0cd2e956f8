"""The change to detect, and how the two images that a detector compares are formed.

``c' = A_r c`` is the reference, ``c'' = A_rz c`` the follow-up from ``z`` times further away, both
simulated from c by the model under test; ``U`` brings the follow-up onto the reference's pixels.
``docs/theory-detectability.md`` has the definitions.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, sqrt
from typing import Protocol

import numpy as np

from analysis.choices import REFERENCE_ZOOM, WINDOW_PX
from simulation import Model, Psf, SamplingGrid, ZoomOperator, zoom_operator
from simulation.arguments import check_fields
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.resampling import BandedMatrix, antialiased_cubic, apply_separable

_REACH_SIGMAS = 6.0
_PLASTIC = 1.324717957244746
"""Root of x^3 = x + 1, for the points of M. Roberts' R2 sequence, 2018."""


class ChangeSignal(Protocol):
    """A change of the scene that an observer knows exactly; px are those of the photograph c."""

    @property
    def reach_px(self) -> float:
        """Distance from its centre beyond which it is negligible, in px of c."""
        ...

    @property
    def sigma_px(self) -> float | None:
        """Width (sigma) of a Gaussian signal, in px of c; None for any other."""
        ...

    @property
    def name(self) -> str:
        """What kind of signal it is."""
        ...

    def image(self, side_px: int, offset_px: tuple[int, int]) -> FloatArray:
        """Signal of contrast 1 in a square image, offset ``(y, x)`` from its middle pixel."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianSignal:
    """A Gaussian spot of peak 1: ``exp(-r^2 / (2 sigma^2))``."""

    sigma_px: float = 2.0

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def reach_px(self) -> float:
        """Distance from its centre beyond which it is negligible, in px of c."""
        return float(_REACH_SIGMAS * self.sigma_px)

    @property
    def name(self) -> str:
        """What kind of signal it is."""
        return "gaussian"

    def image(self, side_px: int, offset_px: tuple[int, int]) -> FloatArray:
        """Signal of contrast 1 in a square image, offset ``(y, x)`` from its middle pixel."""
        position = np.arange(side_px) - side_px // 2
        along_y, along_x = (
            np.exp(-0.5 * ((position - offset) / self.sigma_px) ** 2) for offset in offset_px
        )
        return np.asarray(np.outer(along_y, along_x))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PatchSignal(ByValue):
    """A patch of an image, minus the median of its border, scaled to a largest deviation of 1."""

    levels_dn: FloatArray

    def __post_init__(self) -> None:
        levels = np.asarray(self.levels_dn, dtype=np.float64)
        if levels.ndim != 2 or min(levels.shape) < 3 or not np.all(np.isfinite(levels)):
            raise ValueError("a signal patch must be a grey image of at least 3 x 3 finite pixels")
        border = np.concatenate([levels[0], levels[-1], levels[1:-1, 0], levels[1:-1, -1]])
        levels = levels - np.median(border)
        peak = float(np.abs(levels).max())
        if peak == 0:
            raise ValueError("a constant patch contains no signal")
        object.__setattr__(self, "levels_dn", levels / peak)

    @property
    def reach_px(self) -> float:
        """Distance from its centre beyond which it is negligible, in px of c."""
        return float(ceil(max(self.levels_dn.shape) / 2) + 1)

    @property
    def sigma_px(self) -> float | None:
        """None: a patch has no such width."""
        return None

    @property
    def name(self) -> str:
        """What kind of signal it is."""
        return "patch"

    def image(self, side_px: int, offset_px: tuple[int, int]) -> FloatArray:
        """Signal of contrast 1 in a square image, offset ``(y, x)`` from its middle pixel."""
        rows, cols = self.levels_dn.shape
        top = side_px // 2 + offset_px[0] - rows // 2
        left = side_px // 2 + offset_px[1] - cols // 2
        scene = np.zeros((side_px, side_px))
        scene[top : top + rows, left : left + cols] = self.levels_dn
        return scene


def signal_offsets_px(count: int, period_px: float) -> tuple[tuple[int, int], ...]:
    """Positions of the signal on the pixel grids, ``(y, x)`` in whole px of c, evenly spread.

    ``count``: how many, at least 1. ``period_px``: spacing of the coarser grid; the positions cover
    several of its periods.
    """
    span = 8 * ceil(period_px)
    index = np.arange(1, count + 1)
    positions = np.stack([index / _PLASTIC, index / _PLASTIC**2], axis=1) % 1.0
    offsets = np.floor(positions * span).astype(np.int64) - span // 2
    return tuple((int(y), int(x)) for y, x in offsets)


POSITIONS = 6
"""Positions of the signal against the pixel grids; d' over them scatters by 2 % at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """How the two images are formed and the window in which they are compared.

    ``psf``: total PSF of c; ``bicubic`` needs none. ``reference_zoom``: from c to the reference c'.
    ``window_px``: side of the observer's window on c', odd. ``positions``: of the signal against
    the pixel grids, over which d' is averaged.
    """

    psf: Psf | None
    reference_zoom: float = REFERENCE_ZOOM
    window_px: int = WINDOW_PX
    positions: int = POSITIONS

    def __post_init__(self) -> None:
        if not (self.reference_zoom >= 1 and np.isfinite(self.reference_zoom)):
            raise ValueError(f"reference_zoom must be at least 1, got {self.reference_zoom}")
        if self.window_px % 2 == 0 or self.window_px < 5:
            raise ValueError(f"window_px must be odd and at least 5, got {self.window_px}")
        if self.positions < 1:
            raise ValueError(f"positions must be at least 1, got {self.positions}")


_CUBIC_REACH_PX = 2
"""Follow-up pixels that the cubic takes on either side."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ComparedPair:
    """Reference and follow-up of one scene image, without noise.

    ``reference, followup``: from c to c' and to c''. ``up_y, up_x``: bicubic upscaling ``U`` from
    c'' onto c', along rows and columns. ``zoom``: ratio of the two distances.
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
        """Difference that the pose alone makes, ``U c'' - c'``, where U needs no border."""
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

    ``shape``: ``(rows, cols)`` of c. ``zoom``: ratio of the follow-up's distance to the
    reference's, at least 1. ``reference_zoom``: ratio of the reference's distance to that of c, at
    least 1.
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

    ``signal_px``: distance from the middle that the signal reaches, in px of c.
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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocalChange:
    """A signal of contrast 1 at one position on the pixel grids, in a window on c'.

    ``signal``: ``U A_rz s``, shape (n, n). ``up_y, up_x``: rows of ``U`` for the window, shape (n,
    follow-up pixels).
    """

    signal: FloatArray
    up_y: FloatArray
    up_x: FloatArray

    def noise_variance(self, template: FloatArray) -> float:
        """Variance of a template's response to noise of variance 1 in both images."""
        through = self.up_y.T @ template @ self.up_x
        return float(np.sum(template**2) + np.sum(through**2))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlacedSignal:
    """A signal at several positions on the pixel grids, and the pair that sees it.

    ``offsets_px`` are those from the middle of a square scene of ``side_px``, ``(y, x)``;
    ``windows`` are around them on c'.
    """

    signal: ChangeSignal
    pair: ComparedPair
    side_px: int
    offsets_px: tuple[tuple[int, int], ...]
    windows: tuple[tuple[slice, slice], ...]

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the scene."""
        return self.side_px, self.side_px

    def scenes(self) -> Iterator[tuple[FloatArray, tuple[slice, slice]]]:
        """Scene with the signal at each position, and the window around it."""
        for offset_px, window in zip(self.offsets_px, self.windows, strict=True):
            yield self.signal.image(self.side_px, offset_px), window


def placed_signal(
    signal: ChangeSignal, scenario: Scenario, model: Model, zoom: float
) -> PlacedSignal:
    """Place a signal on the pixel grids of a pair."""
    window_px, reference_zoom = scenario.window_px, scenario.reference_zoom
    if 2 * signal.reach_px / reference_zoom > window_px:
        raise ValueError(
            f"a signal of {2 * signal.reach_px / reference_zoom:.0f} px on the reference is wider "
            f"than the window of {window_px} px"
        )
    period_px = reference_zoom * zoom
    farthest = signal.reach_px + 4 * ceil(period_px)
    side = frame_size_px(scenario.psf, farthest, window_px, zoom, reference_zoom)
    pair = compared_pair((side, side), scenario.psf, model, zoom, reference_zoom)
    offsets = signal_offsets_px(scenario.positions, period_px)
    rows_px, cols_px = pair.reference_grid.rows_px, pair.reference_grid.cols_px
    windows = tuple(
        (
            _window(rows_px, side // 2 + offset_y, window_px),
            _window(cols_px, side // 2 + offset_x, window_px),
        )
        for offset_y, offset_x in offsets
    )
    return PlacedSignal(signal=signal, pair=pair, side_px=side, offsets_px=offsets, windows=windows)


def local_changes(
    signal: ChangeSignal, scenario: Scenario, model: Model, zoom: float
) -> tuple[LocalChange, ...]:
    """Work out what is left of a signal at several positions on the pixel grids.

    Parameters, errors: see `placed_signal`.
    """
    placed = placed_signal(signal, scenario, model, zoom)
    up_y, up_x = placed.pair.up_y.dense(), placed.pair.up_x.dense()
    return tuple(
        LocalChange(
            signal=placed.pair.aligned_of(scene)[rows, cols],
            up_y=_used(up_y[rows]),
            up_x=_used(up_x[cols]),
        )
        for scene, (rows, cols) in placed.scenes()
    )


def _window(positions_px: FloatArray, centre_px: float, window_px: int) -> slice:
    nearest = int(np.argmin(np.abs(positions_px - centre_px)))
    return slice(nearest - window_px // 2, nearest + window_px // 2 + 1)


def _used(rows: FloatArray) -> FloatArray:
    return np.ascontiguousarray(rows[:, np.any(rows != 0.0, axis=0)])
