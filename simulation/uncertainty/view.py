"""A follow-up that is simulated again and again, with other PSFs and of other images."""

from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import AnyArray, FloatArray
from simulation.capture_noise import propagated_variance
from simulation.choices import POSE_MODELS, Model
from simulation.pose import PoseOptions, PoseView, pose_noise_gain, simulate_pose
from simulation.psf import GaussianPsf, Psf, PsfField
from simulation.resampling import SamplingGrid
from simulation.zoom import zoom_operator, zoom_out_on_grid

_UNIT = GaussianPsf(1.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedView:
    """What a follow-up sees of a reference, and the model that simulates it.

    Parameters
    ----------
    reference
        ``(rows, cols)`` of the reference.
    matrix, size
        Homography from follow-up to reference pixels, and ``(width, height)`` of the follow-up.
    model
        ``matched``, ``lmmse`` or ``paper``.
    grid
        Of a follow-up that is merely further away; None for another pose.
    options
        Threads, distortion and the follow-up's place in the camera's frame.
    """

    reference: tuple[int, int]
    matrix: FloatArray
    size: tuple[int, int]
    model: Model
    grid: SamplingGrid | None
    options: PoseOptions

    @classmethod
    def at_zoom(
        cls, reference: tuple[int, int], zoom: float, model: Model, threads: int = 1
    ) -> "SimulatedView":
        """View from ``zoom`` times further away."""
        grid = SamplingGrid.centred(reference, zoom)
        origin_px = (reference[1] - grid.cols) / 2, (reference[0] - grid.rows) / 2
        return cls(
            reference=reference,
            matrix=grid.matrix,
            size=(grid.cols, grid.rows),
            model=model,
            grid=grid,
            options=_of_model(PoseOptions(threads=threads, origin_px=origin_px), model),
        )

    @classmethod
    def of_pose(
        cls,
        reference: tuple[int, int],
        matrix: FloatArray,
        size: tuple[int, int],
        options: PoseOptions,
    ) -> "SimulatedView":
        """View from another pose."""
        return cls(
            reference=reference,
            matrix=matrix,
            size=size,
            model=options.model,
            grid=None,
            options=options,
        )

    @property
    def zoom(self) -> float:
        """Zoom in the middle of the follow-up."""
        x, y = (self.size[0] - 1) // 2, (self.size[1] - 1) // 2
        xx, xy, yy = self._survey(np.array([float(y)]), np.array([float(x)]))[0, 0, 2:]
        return float((xx * yy - xy * xy) ** 0.25)

    def rendered(self, image: AnyArray, psf: Psf | PsfField) -> FloatArray:
        """Follow-up of an image of the reference's size, in double precision."""
        exact = np.asarray(image, dtype=np.float64)
        if self.grid is not None and not isinstance(psf, PsfField):
            threads = self.options.threads
            seen = zoom_out_on_grid(exact, self.grid, psf, self.model, threads=threads)
        else:
            seen = simulate_pose(exact, self.matrix, self.size, psf, self.options).image
        return np.asarray(seen, dtype=np.float64)

    def noise_variance(self, variance_dn2: FloatArray, psf: Psf | PsfField) -> FloatArray:
        """Variance left of independent noise in the reference, of the follow-up's shape.

        Parameters
        ----------
        variance_dn2
            Of each reference pixel, shape ``(rows, cols)`` or ``(rows, cols, channels)``.
        psf
            As calibrated.

        Notes
        -----
        Exact further away. For another pose the sum of the squared weights is multiplied by the
        variance as the follow-up sees it, which is right where it hardly changes within a kernel.
        """
        if self.grid is None or isinstance(psf, PsfField):
            gain = pose_noise_gain(self.matrix, self.reference, self.size, psf, self.options)
            seen = np.maximum(self.rendered(variance_dn2, psf), 0.0)
            return np.asarray(seen * (gain if seen.ndim == 2 else gain[:, :, None]))
        operator = zoom_operator(self.reference, self.grid, psf, self.model)
        if variance_dn2.ndim == 2:
            return propagated_variance(operator, variance_dn2)
        planes = np.moveaxis(variance_dn2, 2, 0)
        return np.stack([propagated_variance(operator, plane) for plane in planes], axis=-1)

    def survey(self) -> FloatArray:
        """Place and stretch of each pixel, shape ``(height, width, 5)``.

        Position x, y in the reference, and the elements xx, xy, yy of ``A A^T``, A being the
        derivative of the warp.
        """
        return self._survey(np.arange(float(self.size[1])), np.arange(float(self.size[0])))

    def pose_view(self, psf: Psf | PsfField) -> PoseView:
        """The view with a PSF, for what varies over it."""
        return PoseView.of(
            self.matrix,
            self.reference,
            self.size,
            psf,
            self.options.origin_px,
            self.options.distortion_k1,
        )

    def _survey(self, rows_px: FloatArray, cols_px: FloatArray) -> FloatArray:
        # Of a PSF of unit width the missing blur is A A^T less the unit matrix.
        seen = self.pose_view(_UNIT).survey(rows_px, cols_px)
        return np.asarray(seen + np.array([0, 0, 1.0, 0, 1.0]))


def _of_model(options: PoseOptions, model: Model) -> PoseOptions:
    known = [name for name in POSE_MODELS if name == model]
    return replace(options, model=known[0]) if known else options
