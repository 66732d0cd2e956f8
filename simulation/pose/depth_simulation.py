"""The image that a camera would take of a scene with depth from another pose.

Every pixel of the follow-up is filtered and sampled by the warp of the surface that it sees, at the
distance that this has: nearer things grow more than those behind them, and hide others. The theory
is in ``docs/theory-depth.md``.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.by_value import ByValue
from simulation.pose._prefilter import SAMPLING_KERNELS
from simulation.pose._surface_filter import (
    LocalPoses,
    lattice,
    local_poses,
    nodes_at,
    surface_filter,
    surface_noise_gain,
)
from simulation.pose._surfaces import local_slopes, parted, seen_points, sight_of, slopes_of
from simulation.pose._warp import BORDER_PX, NEARER_TOLERANCE_PX2, warped
from simulation.pose.depth import DepthView, SceneDepth
from simulation.pose.simulate import (
    SimulatedPose,
    coefficient_window,
    sample_at,
    tiles,
    weight_table,
)
from simulation.pose.view import DEFAULT_OPTIONS, PoseOptions
from simulation.psf import Psf, PsfField
from simulation.sampling_grid import reference_shape, refuse_non_finite

_SLOPE_SIGMA_PX = 1.5
"""Slopes of measured depths are noisy; kernels are as wide as this, and wider."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenSurfaces(ByValue):
    """What a follow-up's pixels see of a scene with depth.

    Parameters
    ----------
    places_px
        Reference positions ``(y, x)``, shape (2, rows, cols); NaN where the reference does not show
        what is seen.
    hidden
        Mask, shape ``(rows, cols)``: pixels that see what was hidden from the reference, or lies at
        an unknown depth.
    outside
        Mask of pixels that look past the reference.
    """

    places_px: FloatArray
    hidden: BoolArray
    outside: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthSampling(ByValue):
    """How a follow-up samples the surfaces of a scene.

    Parameters
    ----------
    view
        Where the follow-up sees the scene.
    seen
        What its pixels see.
    nodes_px
        Where it sees the nodes of a lattice over the reference, ``(x, y)``, shape (n, 2).
    slopes
        Derivative of the reference's position by the follow-up's at these nodes, shape (n, 2, 2);
        NaN where a surface is seen from behind.
    """

    view: DepthView
    seen: SeenSurfaces
    nodes_px: FloatArray
    slopes: FloatArray

    @classmethod
    def of(cls, scene: SceneDepth, view: DepthView) -> "DepthSampling":
        """Follow the scene's surfaces to the follow-up."""
        inverse, sight = 1 / scene.depth, sight_of(view)
        parts = parted(sight, inverse)
        along = slopes_of(inverse, *parts)
        drawn = seen_points(sight, inverse, parts, along, view.follow_up)
        rows, cols = lattice(view.reference)
        smooth = [gaussian_filter(one, _SLOPE_SIGMA_PX)[np.ix_(rows, cols)] for one in along]
        y, x = (one.ravel().astype(np.float64) for one in np.meshgrid(rows, cols, indexing="ij"))
        places, back = local_slopes(
            sight,
            np.stack([x, y], axis=1),
            inverse[np.ix_(rows, cols)].ravel(),
            np.stack([one.ravel() for one in smooth], axis=1),
        )
        return cls(view=view, seen=_seen(view, drawn.x, drawn.y), nodes_px=places, slopes=back)

    def zooms(self) -> tuple[FloatArray, FloatArray]:
        """Reference pixels per follow-up pixel, where it is sampled most coarsely and most finely.

        Shape ``(rows, cols)`` of the follow-up each; NaN where nothing is seen.
        """
        rows, cols = lattice(self.view.reference)
        known = np.isfinite(self.slopes).all(axis=(1, 2))
        both = np.full((len(self.slopes), 2), np.nan)
        both[known] = np.linalg.svd(self.slopes[known], compute_uv=False)
        at = nodes_at((rows, cols), *self.seen.places_px)
        worst, best = np.moveaxis(both.reshape(len(rows), len(cols), 2)[at], -1, 0)
        nothing = np.isnan(self.seen.places_px[0])
        return np.where(nothing, np.nan, worst), np.where(nothing, np.nan, best)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthRendering:
    """A scene from one pose through one PSF, ready for any number of images."""

    view: DepthView
    seen: SeenSurfaces
    local: LocalPoses

    @classmethod
    def of(cls, scene: SceneDepth, view: DepthView, psf: Psf | PsfField) -> "DepthRendering":
        """A ValueError if nothing of the reference is seen, or a field is of other frames."""
        _refuse_other_field(view, psf)
        found = DepthSampling.of(scene, view)
        rows, cols = lattice(view.reference)
        counts = np.zeros((len(rows), len(cols)), dtype=np.bool_)
        shown = ~(found.seen.hidden | found.seen.outside)
        counts[nodes_at((rows, cols), *found.seen.places_px[:, shown])] = True
        local = local_poses(view, psf, found.nodes_px, found.slopes, counts.ravel())
        return cls(view=view, seen=found.seen, local=local)

    def noise_gain(self, options: PoseOptions = DEFAULT_OPTIONS) -> FloatArray:
        """Variance of the follow-up if each reference pixel's is 1; 0 where nothing is seen."""
        gain = surface_noise_gain(
            self.local, options.model, options.noise_ratio, np.nan_to_num(self.seen.places_px)
        )
        return np.where(self.seen.hidden | self.seen.outside, 0.0, gain)

    def photograph(self, image: AnyArray, options: PoseOptions = DEFAULT_OPTIONS) -> SimulatedPose:
        """The follow-up of an image of the reference's frame.

        Parameters, units and errors are those of ``simulate_pose_of_image``. Beside a step of the
        depth the reference's own blur has mixed both sides, over about as many pixels as it is
        wide.
        """
        if reference_shape(image) != self.view.reference:
            rows, cols = self.view.reference
            raise ValueError(
                f"the depth map has {cols} x {rows} px, the image {image.shape[1]} x "
                f"{image.shape[0]} px"
            )
        refuse_non_finite(image)
        dtype = np.dtype(np.float64 if image.dtype == np.float64 else np.float32)
        filtered = surface_filter(self.local, options.model, options.noise_ratio)
        table = weight_table(np.array(SAMPLING_KERNELS[options.model].pieces)).astype(dtype)
        planes = image[:, :, None] if image.ndim == 2 else image
        height, width = self.view.follow_up
        result = np.zeros((planes.shape[2], height, width), dtype=dtype)

        def make(tile: tuple[slice, slice]) -> None:
            y, x = self.seen.places_px[:, *tile]
            if np.isnan(x).all():
                return
            around = (
                max(int(np.floor(np.nanmin(y))), -1),
                min(int(np.ceil(np.nanmax(y))), self.view.reference[0]),
                max(int(np.floor(np.nanmin(x))), -1),
                min(int(np.ceil(np.nanmax(x))), self.view.reference[1]),
            )
            for channel in range(planes.shape[2]):
                window = coefficient_window(planes[:, :, channel], around, filtered, table)
                sample_at(window, x, y, result[channel, *tile])

        with ThreadPoolExecutor(options.threads) as pool:
            list(pool.map(make, tiles(height, width)))
        at = nodes_at((self.local.rows_px, self.local.cols_px), *self.seen.places_px)
        shown = ~(self.seen.hidden | self.seen.outside)
        return SimulatedPose(
            image=result[0]
            if image.ndim == 2
            else np.ascontiguousarray(np.moveaxis(result, 0, -1)),
            nearer=shown & (self.local.missing_px2[at] < -NEARER_TOLERANCE_PX2),
            outside=self.seen.outside,
            hidden=self.seen.hidden,
        )


def _seen(view: DepthView, x: FloatArray, y: FloatArray) -> SeenSurfaces:
    """Tell what is hidden from what the reference's frame does not show, by the plane."""
    rows, cols = np.meshgrid(*(np.arange(float(n)) for n in view.follow_up), indexing="ij")
    back = np.linalg.inv(view.plane)
    on_plane = warped(
        np.asarray(back, np.float64), view.lens, np.stack([cols.ravel(), rows.ravel()], axis=1)
    )
    unseen = ~_is_within(x, y, view.reference)
    plane_x, plane_y = (one.reshape(x.shape) for one in on_plane.T)
    outside = unseen & ~_is_within(plane_x, plane_y, view.reference)
    return SeenSurfaces(
        places_px=np.where(unseen, np.nan, np.stack([y, x])),
        hidden=unseen & ~outside,
        outside=outside,
    )


def _is_within(x: FloatArray, y: FloatArray, shape: tuple[int, int]) -> BoolArray:
    rows, cols = shape
    inside_x = (x >= -BORDER_PX) & (x <= cols - 1 + BORDER_PX)
    return np.asarray(inside_x & (y >= -BORDER_PX) & (y <= rows - 1 + BORDER_PX))


def _refuse_other_field(view: DepthView, psf: Psf | PsfField) -> None:
    """Check that a PSF field belongs to the frames."""
    if not isinstance(psf, PsfField):
        return
    frame = psf.height_px, psf.width_px
    for whose, shape in (("reference", view.reference), ("follow-up", view.follow_up)):
        if shape != frame:
            raise ValueError(
                f"the PSF field belongs to frames of {frame[1]} x {frame[0]} px, but the {whose} "
                f"has {shape[1]} x {shape[0]} px"
            )
