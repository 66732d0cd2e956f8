"""What is known of a planned session: bench, camera, levels, edges, boards and scene."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import sqrt
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.plan import CapturePlan, PlanEntry, estimate_plan, plan_entries
from analysis.pose import ViewingCamera
from analysis.study import (
    BoardCapture,
    BoardSession,
    EdgeLevels,
    EdgeSession,
    PlannedEdge,
    PlanSize,
    StudiedScene,
    TransferModel,
    built_in_scenes,
    edges_of_captures,
)
from calibration.edges import EdgeMeasurement
from calibration.files import read_geometry
from calibration.geometry import CharucoBoard, GeometryCalibration
from calibration.noise import LevelNoise, NoiseCalibration, level_noise
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, Psf
from simulation.arguments import ArgumentTypeError, kind_of
from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise
from standoff.errors import ArgumentError
from standoff.library.bench import bench_config, given_plan
from standoff.library.call import Call, FilePath, NoiseLike, PsfLike, stored_noise
from standoff.library.psf import camera_psf, opened_psf

_BLACK_PAPER = 0.06  # of white: toner on paper reflects a few per cent
_WHITE_OF_RANGE = 0.7
_FULL_DN = {"Mono8": 255.0}
_USUAL_FULL_DN = 4095.0
_MONO8_STEP = 16.0  # of 12 bits; the lower four are cut off
_USUAL_SNR = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _PixelLevels:
    """Levels of edges, the noise of a frame, and where all this comes from.

    ``is_in_dn`` is False where only the ratio of contrast to noise is known, and levels are in
    units of the contrast.
    """

    levels: EdgeLevels
    is_in_dn: bool
    assumptions: tuple[str, ...]


def pixel_levels(
    bench: BenchConfig,
    psf: PsfCalibration | None,
    noise: NoiseCalibration | CaptureNoise | None,
    levels_dn: tuple[float, float] | None,
) -> _PixelLevels:
    """Return levels and noise, by noise.json, a simulated bench, or the edges of psf.json."""
    if levels_dn is not None and not levels_dn[0] < levels_dn[1]:
        raise ArgumentError(
            f"expected a dark and a bright level, got {levels_dn[0]:g} and {levels_dn[1]:g}",
            argument="levels",
        )
    if noise is None and bench.simulated is None:
        return _by_edges(bench, psf, levels_dn)
    if noise is not None:
        single = noise if isinstance(noise, CaptureNoise) else noise.capture_noise
        frame_noise = level_noise(single)
        told = "the pixel noise is that of noise.json"
    else:
        frame_noise = _simulated_noise(bench)
        told = "the pixel noise is that of the simulated sensor in the bench file"
    low, high, whence = _levels(bench, psf, noise, levels_dn)
    return _PixelLevels(
        levels=EdgeLevels(low_dn=low, high_dn=high, frame_noise=frame_noise),
        is_in_dn=True,
        assumptions=(told, f"edges go from {low:.0f} to {high:.0f} DN, {whence}"),
    )


def _simulated_noise(bench: BenchConfig) -> LevelNoise:
    truth = bench.simulated
    if truth is None:
        raise ArgumentError("the bench is not simulated")
    gain = truth.gain_e_per_dn / 10 ** (bench.camera.gain_db / 20)
    single = level_noise(
        CaptureNoise(
            gain_e_per_dn=gain,
            read_noise_e=truth.read_noise_e,
            black_level_dn=truth.black_level_dn,
        )
    )
    if bench.camera.pixel_format != "Mono8":
        return single
    # A level m of 8 bits is 16 m + 7.5 of 12; rounding is that of 8 bits.
    shift = 0.5 * (_MONO8_STEP - 1)
    return LevelNoise(
        offset_dn2=(single.offset_dn2 + single.slope_dn * shift) / _MONO8_STEP**2 + 1 / 12,
        slope_dn=single.slope_dn / _MONO8_STEP,
        floor_dn2=single.floor_dn2 / _MONO8_STEP**2 + 1 / 12,
    )


def _levels(
    bench: BenchConfig,
    psf: PsfCalibration | None,
    noise: NoiseCalibration | CaptureNoise | None,
    levels_dn: tuple[float, float] | None,
) -> tuple[float, float, str]:
    """Dark and bright level, and where they come from."""
    if levels_dn is not None:
        return *levels_dn, "as given"
    truth = bench.simulated
    if truth is not None:
        white_e = min(truth.white_e_per_us * bench.camera.exposure_us, truth.full_well_e)
        gain = truth.gain_e_per_dn / 10 ** (bench.camera.gain_db / 20)
        low, high = (truth.black_level_dn + part * white_e / gain for part in (_BLACK_PAPER, 1.0))
        if bench.camera.pixel_format == "Mono8":
            low, high = ((one - 0.5 * (_MONO8_STEP - 1)) / _MONO8_STEP for one in (low, high))
        return low, high, "black and white paper at the bench's exposure"
    full = _FULL_DN.get(bench.camera.pixel_format, _USUAL_FULL_DN)
    if isinstance(noise, NoiseCalibration):
        full = noise.saturation_dn or full
    high = _WHITE_OF_RANGE * full
    contrasts = [edge.contrast for edge in (psf.edges_used if psf else ()) if edge.contrast]
    if contrasts:
        contrast = min(float(np.median(contrasts)), 0.999)
        return (
            high * (1 - contrast) / (1 + contrast),
            high,
            "the contrast of the edges in psf.json at 0.7 of the range",
        )
    return _BLACK_PAPER * high, high, "black and white paper at 0.7 of the range"


def _by_edges(
    bench: BenchConfig, psf: PsfCalibration | None, levels_dn: tuple[float, float] | None
) -> _PixelLevels:
    """Levels in units of the contrast, with the noise that the edges of psf.json had."""
    known = [edge.snr for edge in (psf.edges_used if psf else ()) if edge.snr]
    snr = float(np.median(known)) if known else _USUAL_SNR
    frames = bench.capture.frames_per_capture
    whence = "of the edges in psf.json" if known else "assumed, as psf.json has no edges"
    low, high = levels_dn or (0.0, 1.0)
    variance = ((high - low) / snr) ** 2 * frames
    return _PixelLevels(
        levels=EdgeLevels(
            low_dn=low,
            high_dn=high,
            frame_noise=LevelNoise(offset_dn2=variance, slope_dn=0.0, floor_dn2=variance),
        ),
        is_in_dn=levels_dn is not None,
        assumptions=(
            f"the contrast-to-noise ratio is {snr:.0f}, {whence}, for means of {frames} frames, as "
            "the bench takes them; a noise.json gives it for any number of frames",
        ),
    )


def _noise_at(levels: EdgeLevels, level_dn: float, frames: int) -> float:
    """Standard deviation of a pixel of a capture at a level."""
    variance = levels.frame_noise.variance_dn2(np.array([level_dn]))
    return sqrt(float(variance[0]) / frames)


_NEAR_DEG = 15.0
_PARALLEL_DEG = 5.0
_OF_FRAME = 0.8
_USUAL_LENGTH_PX = 200.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeTemplate:
    """The edges that a capture of kind edge is expected to show.

    Parameters
    ----------
    known
        Edges of psf.json that were used.
    per_capture, length_px
        Number of edges per capture and their length; None takes them from ``known``.
    frame
        Rows and columns of a frame; None if not known.
    """

    known: tuple[EdgeMeasurement, ...] = ()
    per_capture: int | None = None
    length_px: float | None = None
    frame: tuple[int, int] | None = None

    @classmethod
    def of(
        cls,
        psf: PsfCalibration | None,
        frame: tuple[int, int] | None,
        per_capture: int | None,
        length_px: float | None,
    ) -> "EdgeTemplate":
        """Return the template that follows from a psf.json."""
        known = () if psf is None else psf.edges_used
        return cls(known=known, per_capture=per_capture, length_px=length_px, frame=frame)

    def at(self, orientation_deg: float) -> list[tuple[float, float]]:
        """Angle relative to the target's orientation and length in px of each edge of a capture."""
        if self.per_capture is not None or not self.known:
            # Sides of squares: every other one is turned by a right angle.
            count = self.per_capture or 1
            length_px = self._length_px(orientation_deg)
            return [(90.0 * (number % 2), length_px) for number in range(count)]
        images = [
            list(edges)
            for _, edges in groupby(
                sorted(self.known, key=lambda one: one.image), key=lambda one: one.image
            )
        ]
        if all(_is_parallel(edges) for edges in images):
            nearest = min(images, key=lambda edges: _apart_deg(edges[0].angle_deg, orientation_deg))
            return [(0.0, self.length_px or edge.length_px) for edge in nearest]
        typical = int(np.median([len(edges) for edges in images]))
        pattern = min(images, key=lambda edges: abs(len(edges) - typical))
        return [(edge.angle_deg, self.length_px or edge.length_px) for edge in pattern]

    def _length_px(self, orientation_deg: float) -> float:
        if self.length_px is not None:
            return self.length_px
        if not self.known:
            return _USUAL_LENGTH_PX if self.frame is None else _OF_FRAME * min(self.frame)
        near = [e for e in self.known if _apart_deg(e.angle_deg, orientation_deg) <= _NEAR_DEG]
        return float(np.mean([edge.length_px for edge in near or self.known]))

    @property
    def assumption(self) -> str:
        """Where the template comes from, in words."""
        if self.length_px is not None and self.per_capture is not None:
            return "the number and length of the edges in a capture are as given"
        if self.known:
            return "edges in a capture have the number and length of psf.json, unless given"
        return "psf.json has no edges: one per capture, over 0.8 of the frame, unless given"


def _apart_deg(first_deg: float, second_deg: float) -> float:
    """Angle between two lines, from 0 to 90 degrees."""
    return abs((first_deg - second_deg + 90.0) % 180.0 - 90.0)


def _is_parallel(edges: Sequence[EdgeMeasurement]) -> bool:
    """Whether the edges of a photograph are pieces of one, or parallel."""
    return all(_apart_deg(one.angle_deg, edges[0].angle_deg) <= _PARALLEL_DEG for one in edges)


def planned_edges(
    entries: Sequence[PlanEntry],
    template: EdgeTemplate,
    levels: EdgeLevels,
    frames: int,
    focus_scatter_px2: float,
) -> EdgeSession | None:
    """Return the edges that a plan captures; None where it captures none."""
    edges: list[PlannedEdge] = []
    for entry in entries:
        if entry.kind == "edge":
            found = edges_of_captures([entry.orientation_deg], template.at(entry.orientation_deg))
            edges += (
                PlannedEdge(capture=entry.index, angle_deg=one.angle_deg, length_px=one.length_px)
                for one in found
            )
    if not edges:
        return None
    return EdgeSession(
        edges=tuple(edges), levels=levels, frames=frames, focus_scatter_px2=focus_scatter_px2
    )


def _planned_boards(entries: Sequence[PlanEntry]) -> tuple[BoardCapture, ...]:
    """Return the captures of boards of a plan."""
    placements: dict[tuple[str, str, float], int] = {}
    return tuple(
        BoardCapture(
            placement=placements.setdefault(entry.placement, len(placements)),
            orientation_deg=entry.orientation_deg,
            height_mm=entry.height_mm,
        )
        for entry in entries
        if entry.kind == "board"
    )


_CONTRAST = 0.05  # of the mean level
_USUAL_NOISE_DN = 2.0
_PLACEMENT_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SoughtChange:
    """The change whose d' is asked for; a value that is None follows from the other inputs."""

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
        noise: NoiseLike | None,
        geometry: GeometryCalibration | FilePath | None,
    ) -> Self:
        """Take the inputs, and read those that are given as files."""
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
            noise=stored_noise(noise),
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
        """What is assumed of captures with exposures of their own, one sentence each."""
        own = [
            entry
            for entry in self.entries
            if entry.kind in ("edge", "board")
            and (entry.bracket is not None or entry.exposure_us is not None)
        ]
        if not own:
            return ()
        return (f"{len(own)} captures with their own exposure are treated as at the bench's",)

    def focus_scatter_px2(self, stated: float | None) -> float | None:
        """Focus scatter, as stated or else by psf.json; None if neither states it."""
        if stated is not None:
            return stated
        if self.calibration is None or self.calibration.focus is None:
            return None
        return self.calibration.focus.scatter_px2

    def height_scatter_mm(self, stated: float | None) -> float:
        """Standard deviation of heights read back, as stated, by geometry.json, or by the stage."""
        if stated is not None:
            return stated
        if self.geometry is not None and self.geometry.height_scatter_mm is not None:
            return self.geometry.height_scatter_mm
        stage = self.bench.stage
        return stage.tolerance_mm if stage.driver == "manual" else 0.0

    def board(
        self, board: CharucoBoard, pixels: _PixelLevels, height_scatter_mm: float
    ) -> BoardSession | None:
        """Return the captures of a board; None where there are none or the frame is not known."""
        captures, frame = _planned_boards(self.entries), self.frame
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
        self, photographs: Sequence[FloatArray], pixels: _PixelLevels, change: SoughtChange
    ) -> StudiedScene:
        """Return the scene of d': the photographs, or the built-in pictures."""
        levels = pixels.levels
        shown = tuple(photographs) or built_in_scenes(levels.low_dn, levels.high_dn, self.gaussian)
        mean_dn = float(np.mean([image.mean() for image in shown]))
        noise_dn = change.noise_dn
        if noise_dn is None and (pixels.is_in_dn or not photographs):
            noise_dn = _noise_at(levels, mean_dn, self.frames)
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
        """Return the size of the plan, and the time that more of each part of it takes."""
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
