"""Opaque slanted rectangles as a known camera sees them, exactly, from any distance and pose.

A scene is periodic and given by its Fourier coefficients; a photograph is its series, multiplied by
the camera's transfer function and summed at the pixels. Shares nothing with ``simulation``.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import exp, log, pi
from typing import Self

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import map_coordinates

from benchmarks.truth.lenses import Camera, Transfer, elsewhere
from benchmarks.truth.pairs import PairPose
from simulation.arrays import FloatArray

LEVELS_DN = (20, 235)
SIDES_PX = (4.0, 60.0)
RECTANGLES_PER_PX = 0.006
"""With these, bicubic is as far off as in the table that the design of the model started from."""

_LINES = 8
"""Lines per fine cell along which a rectangle's part of it is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A periodic scene: coefficients of its Fourier series, as ``rfft2`` orders them.

    ``side_px`` reference pixels a period, ``samples_per_px`` fine samples a pixel: the series ends
    at half as many cycles per pixel. Reference pixel (0, 0) has its centre at fine sample (0, 0).
    """

    side_px: int
    samples_per_px: int
    coefficients: NDArray[np.complex128] = field(repr=False)

    @classmethod
    def of_cells(cls, levels_dn: FloatArray, samples_per_px: int) -> "Scene":
        """Scene with these means over square cells around the fine samples, shape (side, side)."""
        side = len(levels_dn)
        made = cls(side // samples_per_px, samples_per_px, scipy.fft.rfft2(levels_dn) / side**2)
        fx, fy = made.frequencies
        cell = np.sinc(fx / samples_per_px) * np.sinc(fy / samples_per_px)
        return cls(made.side_px, samples_per_px, made.coefficients / cell)

    @property
    def frequencies(self) -> tuple[FloatArray, FloatArray]:
        """Cycles per reference pixel along x and y, shapes ``(1, n)`` and ``(m, 1)``."""
        side = self.side_px * self.samples_per_px
        fx = scipy.fft.rfftfreq(side, 1 / self.samples_per_px)
        fy = scipy.fft.fftfreq(side, 1 / self.samples_per_px)
        return fx[None, :], fy[:, None]

    @property
    def variance_dn2(self) -> float:
        """Variance of the scene itself."""
        power = np.abs(self.coefficients) ** 2
        mirrored = power[:, 1:-1].sum()
        return float(power.sum() + mirrored - power[0, 0])

    @property
    def mean_dn(self) -> float:
        """Mean of the scene."""
        return float(self.coefficients[0, 0].real)

    def reference(self, camera: Camera) -> FloatArray:
        """Photograph at the reference's pixels, one period, shape ``(side, side)``."""
        series = self.coefficients * camera.otf(*self.frequencies)
        side = self.side_px * self.samples_per_px
        fine = scipy.fft.irfft2(series * side**2, s=(side, side))
        return np.ascontiguousarray(fine[:: self.samples_per_px, :: self.samples_per_px])

    def seen(self, transfer: Transfer, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Levels at positions in reference pixels, through a transfer function.

        The two broadcast. ``transfer`` takes cycles per *reference* pixel: of a camera at the
        ``zoom``-fold distance that is ``lambda fx, fy: camera.otf(zoom * fx, zoom * fy)``.
        """
        return _series_at(self, self.coefficients * transfer(*self.frequencies), x_px, y_px)

    def from_reference(self, reference: FloatArray, kernel: FloatArray) -> NDArray[np.complex128]:
        """Fourier series of a reference, as impulses, through a kernel's transfer function.

        ``kernel`` has the shape of ``coefficients``; a sampled image is periodic in frequency.
        """
        spectrum = np.fft.fft2(reference) / self.side_px**2
        rows, cols = self.coefficients.shape
        tiled = spectrum[np.arange(rows) % self.side_px][:, np.arange(cols) % self.side_px]
        return np.asarray(tiled * kernel)


def _series_at(
    scene: Scene, series: NDArray[np.complex128], x_px: FloatArray, y_px: FloatArray
) -> FloatArray:
    """Sum a Fourier series at positions: a quintic spline through its fine samples.

    Exact at fine samples; between them to 1e-3 DN where the series is nearly 0 at its end, as it
    is through any camera from 1.3 times the distance.
    """
    side = scene.side_px * scene.samples_per_px
    fx, fy = scene.frequencies
    spline = _spline_transfer(fx / scene.samples_per_px) * _spline_transfer(
        fy / scene.samples_per_px
    )
    coefficients = scipy.fft.irfft2(series * side**2 / spline, s=(side, side))
    x, y = np.broadcast_arrays(x_px * scene.samples_per_px, y_px * scene.samples_per_px)
    return np.asarray(
        map_coordinates(coefficients, [y, x], order=5, mode="grid-wrap", prefilter=False)
    )


def _spline_transfer(freq_cy_per_sample: FloatArray) -> FloatArray:
    """Transfer function of the samples of the quintic B-spline."""
    basis = BSpline.basis_element(np.arange(-3, 4), extrapolate=False)
    angle = 2 * pi * freq_cy_per_sample
    return np.asarray(
        basis(0.0) + 2 * basis(1.0) * np.cos(angle) + 2 * basis(2.0) * np.cos(2 * angle)
    )


def slanted_rectangles(side_px: int, samples_per_px: int, seed: int) -> Scene:
    """Opaque rectangles at any angle over one another, on a torus.

    Levels are even over 20-235 DN and sides over 4-60 px by their logarithm; later ones hide
    earlier ones, and they cover the scene several times over.
    """
    rng = np.random.default_rng(seed)
    cells = np.full((side_px * samples_per_px, side_px * samples_per_px), 128.0)
    for _ in range(round(RECTANGLES_PER_PX * side_px**2)):
        sides = [exp(rng.uniform(log(SIDES_PX[0]), log(SIDES_PX[1]))) for _ in "xy"]
        corners = rectangle_corners(rng.uniform(0, side_px, 2), sides, rng.uniform(0, pi))
        cover(cells, corners, samples_per_px, float(rng.integers(LEVELS_DN[0], LEVELS_DN[1] + 1)))
    return Scene.of_cells(cells, samples_per_px)


def rectangle_corners(centre_px: FloatArray, sides_px: list[float], turn_rad: float) -> FloatArray:
    """Corners (x, y) of a rectangle turned from x to y, shape (4, 2)."""
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(sides_px) / 2
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return np.asarray(half @ np.array([[c, s], [-s, c]]) + centre_px)


def cover(cells: FloatArray, corners_px: FloatArray, samples_per_px: int, level_dn: float) -> None:
    """Lay a convex polygon and its periodic copies over the fine cells, in place.

    A cell that is covered in part takes that part of the level.
    """
    # Cell (0, 0) has its centre at position (0, 0), its corner at (0, 0) of the loop below.
    _cover(cells, corners_px * samples_per_px + 0.5, level_dn)


@njit(cache=True)
def _cover(cells: FloatArray, corners: FloatArray, level_dn: float) -> None:
    """Cover row by row: exact along x, by lines along y."""
    side = cells.shape[0]
    left = int(np.floor(corners[:, 0].min()))
    width = int(np.floor(corners[:, 0].max())) - left + 1
    share = np.empty(width + 1)
    for row in range(int(np.floor(corners[:, 1].min())), int(np.floor(corners[:, 1].max())) + 1):
        share[:] = 0.0
        for line in range(_LINES):
            first, last = _crossings(corners, row + (line + 0.5) / _LINES)
            if first >= last:
                continue
            begin, end = int(np.floor(first)) - left, int(np.floor(last)) - left
            # Differences of what each cell gets: its sum along the row is the covered length.
            share[begin] += 1 - (first - left - begin)
            share[begin + 1] += first - left - begin
            share[end] -= 1 - (last - left - end)
            share[end + 1] -= last - left - end
        covered = 0.0
        for col in range(width):
            covered += share[col]
            part = covered / _LINES
            y, x = row % side, (left + col) % side
            cells[y, x] += part * (level_dn - cells[y, x])


@njit(cache=True)
def _crossings(corners: FloatArray, y: float) -> tuple[float, float]:
    """Where a line along x enters and leaves a convex polygon."""
    first, last = np.inf, -np.inf
    for index in range(len(corners)):
        x0, y0 = corners[index - 1]
        x1, y1 = corners[index]
        if min(y0, y1) <= y < max(y0, y1):
            x = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
            first, last = min(first, x), max(last, x)
    return first, last


CORRELATION_PX = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Ideal:
    """Estimator of what a camera sees, from a reference that it took of such a scene.

    ``spectrum_share`` is ``H S / (sum_m |H(f + m)|^2 S(f + m) + N)`` at the scene's frequencies.
    """

    scene: Scene
    spectrum_share: FloatArray = field(repr=False)

    @classmethod
    def of(cls, scene: Scene, camera: Camera, noise_dn: float) -> Self:
        """Make the estimator for white noise of this standard deviation in the reference."""
        fx, fy = scene.frequencies
        density = 2 * pi * CORRELATION_PX**2 * scene.variance_dn2
        spectrum = density / (1 + (2 * pi * CORRELATION_PX) ** 2 * (fx * fx + fy * fy)) ** 1.5
        otf = camera.otf(fx, fy)
        aliased = _folded(otf * otf * spectrum, scene.side_px)
        return cls(scene, otf * spectrum / (aliased + noise_dn**2))

    def seen(
        self, reference: FloatArray, far: Transfer, x_px: FloatArray, y_px: FloatArray
    ) -> FloatArray:
        """Estimate what the camera sees from elsewhere, at positions in the reference.

        ``reference`` is one period; ``far`` is the camera's transfer function there, in cycles per
        reference pixel; the positions broadcast.
        """
        kernel = far(*self.scene.frequencies) * self.spectrum_share
        series = self.scene.from_reference(reference, kernel / kernel[0, 0])
        return _series_at(self.scene, series, x_px, y_px)


def _folded(half_plane: FloatArray, side_px: int) -> FloatArray:
    """Sum a real, symmetric function of frequency over the pixels' lattice, in the same layout."""
    rows, half = half_plane.shape
    mirrored = half_plane[-np.arange(rows) % rows, half - 2 : 0 : -1]
    plane = np.concatenate([half_plane, mirrored], axis=1)
    copies = rows // side_px
    base = plane.reshape(copies, side_px, copies, side_px).sum(axis=(0, 2))
    return np.asarray(base[np.arange(rows) % side_px][:, np.arange(half) % side_px])


_NODES = 5
"""Chebyshev nodes per axis, at which the local transfer function is exact: a test has the error."""

_DIFFERENCE_PX = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose(PairPose):
    """A camera that looks at the middle of a plane; both frames are square."""

    reference_side: int
    followup_side: int

    @property
    def name(self) -> str:
        """As tables write it."""
        extra = f", turn {self.turn_deg:g}" if self.turn_deg else ""
        extra += f", k1 {self.distortion_k1:g}" if self.distortion_k1 else ""
        return f"zoom {self.zoom:g}, tilt {self.tilt_deg:g} at {self.bearing_deg:g}{extra}"

    @property
    def homography(self) -> FloatArray:
        """Follow-up pixel (x, y, 1) to reference pixel, both without distortion, shape (3, 3)."""
        aside = np.eye(3)
        aside[:2, 2] = (self.reference_side - self.followup_side) / 2
        return np.asarray(self.matrix((self.reference_side,) * 2) @ aside)

    def seen(self, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Reference positions (x, y) of follow-up positions."""
        aside = (self.reference_side - self.followup_side) / 2
        return self.positions(x_px + aside, y_px + aside, (self.reference_side,) * 2)

    def jacobian(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Derivative of the reference position, shape (..., 2, 2), order (x, y)."""
        h = _DIFFERENCE_PX
        along_x = np.subtract(self.seen(x_px + h, y_px), self.seen(x_px - h, y_px))
        along_y = np.subtract(self.seen(x_px, y_px + h), self.seen(x_px, y_px - h))
        columns = np.stack([along_x, along_y], axis=-1) / (2 * h)
        return np.moveaxis(columns, 0, -2)

    @property
    def pixels(self) -> tuple[FloatArray, FloatArray]:
        """Follow-up pixels x and y, shape ``(side, side)`` each."""
        y, x = np.mgrid[: self.followup_side, : self.followup_side].astype(np.float64)
        return x, y

    def judged(self, margin_px: float) -> np.ndarray:
        """Pixels that look at the reference's middle and are the coarser ones in all directions."""
        x, y = self.seen(*self.pixels)
        last = self.reference_side - 1 - margin_px
        inside = (x >= margin_px) & (x <= last) & (y >= margin_px) & (y <= last)
        return inside & (np.linalg.svd(self.jacobian(*self.pixels))[1][..., 1] >= 1)


def pose_photograph(scene: Scene, camera: Camera, pose: Pose) -> FloatArray:
    """Photograph of a scene from a pose, shape ``(side, side)``.

    The follow-up's PSF is that of the camera in its own pixels, everywhere in its frame.
    """
    return _blended(pose, camera, scene.seen)


def ideal_pose(ideal: Ideal, camera: Camera, reference: FloatArray, pose: Pose) -> FloatArray:
    """Best linear estimate of that photograph from the reference."""
    return _blended(pose, camera, partial(ideal.seen, reference))


def _blended(
    pose: Pose, camera: Camera, seen: Callable[[Transfer, FloatArray, FloatArray], FloatArray]
) -> FloatArray:
    """Interpolate, over the frame, images that are each right for one node's derivative."""
    half = pose.followup_side / 2
    nodes = (pose.followup_side - 1) / 2 + half * np.cos(pi * (np.arange(_NODES) + 0.5) / _NODES)
    pixels = np.arange(pose.followup_side, dtype=np.float64)
    weights = _lagrange(nodes, pixels)
    x, y = pose.seen(*pose.pixels)
    total = np.zeros_like(x)
    for row, node_y in enumerate(nodes):
        for col, node_x in enumerate(nodes):
            far = elsewhere(camera, pose.jacobian(np.array(node_x), np.array(node_y)))
            total += np.outer(weights[row], weights[col]) * seen(far, x, y)
    return total


def _lagrange(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Lagrange's polynomials of the nodes, shape ``(len(nodes), len(at))``."""
    made = np.ones((len(nodes), len(at)))
    for index, node in enumerate(nodes):
        for other in np.delete(nodes, index):
            made[index] *= (at - other) / (node - other)
    return made
