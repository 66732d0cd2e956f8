"""All that a study is told: plan, bench, PSF, noise, geometry, and what stands in for the rest."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.plan import CapturePlan, PlanEntry, estimate_plan, plan_entries
from analysis.pose import ViewingCamera
from analysis.study import (
    BoardSession,
    PlanSize,
    StudiedScene,
    TransferModel,
    built_in_scenes,
)
from calibration.files import read_geometry, read_noise
from calibration.geometry import CharucoBoard, GeometryCalibration
from calibration.noise import NoiseCalibration
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, Psf
from simulation.arguments import ArgumentTypeError, kind_of
from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise
from standoff.errors import ArgumentError
from standoff.library.bench import bench_config, given_plan
from standoff.library.call import Call
from standoff.library.inputs import FilePath, NoiseLike, PsfLike
from standoff.library.psf import camera_psf, opened_psf
from standoff.library.study.pixel_levels import PixelLevels, noise_at
from standoff.library.study.planned_session import planned_boards

_CONTRAST = 0.05  # of the mean level
_USUAL_NOISE_DN = 2.0
_PLACEMENT_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SoughtChange:
    """The change whose d' is asked for; None for what follows from the rest."""

    contrast_dn: float | None
    signal_sigma_px: float
    noise_dn: float | None
    min_d_prime: float
    planned_count: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownInputs:
    """What is known before the session.

    ``calibration`` is None where the PSF is not that of a calibration; ``gaussian`` is the Gaussian
    nearest to ``psf``.
    """

    plan: CapturePlan
    entries: tuple[PlanEntry, ...]
    bench: BenchConfig
    calibration: PsfCalibration | None
    psf: Psf
    gaussian: GaussianPsf
    noise: NoiseCalibration | CaptureNoise | None
    geometry: GeometryCalibration | None

    @classmethod
    def of(
        cls,
        call: Call,
        session: tuple[CapturePlan | FilePath, BenchConfig | FilePath, Mapping[str, Any] | None],
        psf: PsfLike,
        noise: NoiseLike | NoiseCalibration | None,
        geometry: GeometryCalibration | FilePath | None,
    ) -> Self:
        """Read what is given as a file.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        PlanError, BenchConfigError, PsfFileError, NoiseFileError, GeometryFileError
            If a file cannot be read.
        """
        plan, bench, settings = session
        stated = given_plan(plan)
        stored = opened_psf(psf)
        best = camera_psf(call, stored)
        calibration = stored if isinstance(stored, PsfCalibration) else None
        source = str(psf) if isinstance(psf, str | PathLike) else "psf"
        return cls(
            plan=stated,
            entries=plan_entries(stated),
            bench=bench_config(bench, settings),
            calibration=calibration,
            psf=best,
            gaussian=_gaussian(best) if calibration is None else calibration.total_psf(source),
            noise=read_noise(Path(noise)) if isinstance(noise, str | PathLike) else noise,
            geometry=_geometry(geometry),
        )

    @property
    def frames(self) -> int:
        """Frames of a planned capture."""
        return self.plan.frames_per_capture or self.bench.capture.frames_per_capture

    @property
    def frame(self) -> tuple[int, int] | None:
        """Rows and columns of a frame; None where neither bench nor psf.json says."""
        stored = self.calibration
        if self.bench.frame_shape is not None or stored is None:
            return self.bench.frame_shape
        if stored.picture_height_px is None or stored.picture_width_px is None:
            return None
        return stored.picture_height_px, stored.picture_width_px

    @property
    def focal_length_px(self) -> float:
        """Focal length by geometry.json, or by the bench file."""
        measured = None if self.geometry is None else self.geometry.focal_length_px
        optics = self.bench.optics
        return measured or 1000 * optics.focal_length_mm / optics.pixel_pitch_um

    @property
    def pupil_offset_mm(self) -> float | None:
        """Pupil offset by geometry.json, or what a simulated bench states."""
        if self.geometry is not None:
            return self.geometry.pupil_offset_mm
        return None if self.bench.simulated is None else self.bench.simulated.pupil_offset_mm

    @property
    def transfer(self) -> TransferModel:
        """Transfer function of lens and pixel."""
        stored = self.calibration
        if stored is None:
            return TransferModel.of_gaussian(self.gaussian.covariance_px2)
        errs_px = [edge.sigma_err_px for edge in stored.edges_used]
        return TransferModel.of_calibration(stored.transfer_2d, self.gaussian, errs_px)

    @property
    def exposure_assumptions(self) -> tuple[str, ...]:
        """What is taken for granted of captures with exposures of their own."""
        own = [
            entry
            for entry in self.entries
            if entry.kind in ("edge", "board")
            and (entry.bracket is not None or entry.exposure_us is not None)
        ]
        if not own:
            return ()
        return (f"{len(own)} captures with exposures of their own count as at the bench's",)

    def focus_scatter_px2(self, stated: float | None) -> float | None:
        """Scatter of the focus, as stated or as psf.json has it; None if nothing says."""
        if stated is not None:
            return stated
        if self.calibration is None or self.calibration.focus is None:
            return None
        return self.calibration.focus.scatter_px2

    def height_scatter_mm(self, stated: float | None) -> float:
        """Scatter of the heights read back."""
        if stated is not None:
            return stated
        if self.geometry is not None and self.geometry.height_scatter_mm is not None:
            return self.geometry.height_scatter_mm
        stage = self.bench.stage
        return stage.tolerance_mm if stage.driver == "manual" else 0.0

    def board(
        self, board: CharucoBoard, pixels: PixelLevels, height_scatter_mm: float
    ) -> BoardSession | None:
        """Return the captures of a board; None where there are none or the frame is not known."""
        captures, frame = planned_boards(self.entries), self.frame
        offset_mm = self.pupil_offset_mm or 0.0
        if not captures or frame is None:
            return None
        if min(one.height_mm for one in captures) + offset_mm <= 0:
            return None
        gaussian = self.gaussian
        return BoardSession(
            captures=captures,
            board=board,
            width_px=frame[1],
            height_px=frame[0],
            focal_length_px=self.focal_length_px,
            pupil_offset_mm=offset_mm,
            sigma_px=sqrt(gaussian.sigma_x_px * gaussian.sigma_y_px),
            levels=pixels.levels,
            frames=self.frames,
            height_scatter_mm=height_scatter_mm,
        )

    def scene(
        self, photographs: Sequence[FloatArray], pixels: PixelLevels, change: SoughtChange
    ) -> StudiedScene:
        """Return the scene of d': the photographs, or the built-in pictures."""
        levels = pixels.levels
        shown = tuple(photographs) or built_in_scenes(levels.low_dn, levels.high_dn, self.gaussian)
        mean_dn = float(np.mean([image.mean() for image in shown]))
        noise_dn = change.noise_dn
        if noise_dn is None and (pixels.is_in_dn or not photographs):
            noise_dn = noise_at(levels, mean_dn, self.frames)
        is_own_noise = change.noise_dn is None and noise_dn is not None
        frame = self.frame
        camera = None
        if frame is not None and min(frame) >= 16:
            camera = ViewingCamera(
                focal_length_px=self.focal_length_px, width_px=frame[1], height_px=frame[0]
            )
        return StudiedScene(
            photographs=shown,
            planned_count=change.planned_count,
            noise_dn=_USUAL_NOISE_DN if noise_dn is None else noise_dn,
            noise_relative_err=self._noise_relative_err(mean_dn) if is_own_noise else 0.0,
            contrast_dn=change.contrast_dn or max(_CONTRAST * abs(mean_dn), 1e-6),
            signal_sigma_px=change.signal_sigma_px,
            min_d_prime=change.min_d_prime,
            camera=camera,
        )

    def _noise_relative_err(self, level_dn: float) -> float:
        if not isinstance(self.noise, NoiseCalibration):
            return 0.0
        return self.noise.relative_err(level_dn) or 0.0

    def size(self, edges: int, photographs: int) -> PlanSize:
        """Return how much the plan has of everything, and what more of it costs."""
        cost = estimate_plan(self.plan, self.entries, self.bench, None)
        camera = self.bench.camera
        period_s = max(1 / camera.frame_rate_hz, 1e-6 * camera.exposure_us)
        return PlanSize(
            frames=self.frames,
            edges=edges,
            photographs=photographs,
            run_s=cost.seconds + _PLACEMENT_S * cost.placements,
            frame_s=period_s * len(self.entries),
        )


def _gaussian(psf: Psf) -> GaussianPsf:
    if isinstance(psf, GaussianPsf):
        return psf
    gaussian = getattr(psf, "gaussian", None)
    if isinstance(gaussian, GaussianPsf):
        return gaussian
    raise ArgumentError("give a calibration or a Gaussian, whose widths are known", argument="psf")


def _geometry(geometry: GeometryCalibration | FilePath | None) -> GeometryCalibration | None:
    if geometry is None or isinstance(geometry, GeometryCalibration):
        return geometry
    if isinstance(geometry, str | PathLike):
        return read_geometry(Path(geometry))
    raise ArgumentTypeError(
        f"expected a geometry or a path, got {kind_of(geometry)}", argument="geometry"
    )
