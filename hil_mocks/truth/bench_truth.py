"""The truth of the simulated bench, for tests, benchmarks and the demo's summary."""

from collections import OrderedDict
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig
from acquisition.errors import BenchConfigError
from hil_mocks.truth.relief import SeenRelief
from hil_mocks.truth.render import (
    PIXEL_VARIANCE_PX2,
    CameraPose,
    Illumination,
    Lens,
    PinholeCamera,
    Renderer,
    Sensor,
)
from hil_mocks.truth.scenes import Placed
from hil_mocks.truth.targets import TARGETS, scene_of

VIEWS_KEPT = 8
_TRUTH_STEP_PX = 5
_BORDER_PX = 4


class _FoundPose(Protocol):
    """A pose that is held against the truth: where follow-up pixels lie in the reference."""

    @property
    def followup_shape(self) -> tuple[int, int]:
        """Rows and columns of the follow-up."""
        ...

    @property
    def reference_shape(self) -> tuple[int, int]:
        """Rows and columns of the reference."""
        ...

    def to_reference_px(
        self, y: NDArray[np.float64], x: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Reference coordinates ``(y, x)`` of follow-up pixels."""
        ...


class BenchTruth:
    """The physics of one simulated bench: geometry, sharpness and noise.

    Heights are true ones, in mm on the stage's scale; covariances are ``(2, 2)`` in px^2, order
    (x, y); homographies take ``(x, y, 1)`` of pixel centres. ``camera`` (a `PinholeCamera`),
    ``lens``, ``sensor`` and ``renderer`` are its parts, ``settings`` what the bench file says.
    BenchConfigError if the bench has no ``[simulated]`` section, or one impossible for a lens.
    """

    def __init__(self, config: BenchConfig) -> None:
        if config.simulated is None:
            raise BenchConfigError("the bench has no [simulated] section", keys=("simulated",))
        self.settings = simulated = config.simulated
        optics = config.optics
        try:
            self.camera = PinholeCamera(
                width_px=simulated.width_px,
                height_px=simulated.height_px,
                focal_length_mm=optics.focal_length_mm,
                pixel_pitch_um=optics.pixel_pitch_um,
                pupil_offset_mm=simulated.pupil_offset_mm,
                k1=simulated.k1,
            )
            self.lens = Lens(
                sigma_x_px=simulated.optical_sigma_x_px,
                sigma_y_px=simulated.optical_sigma_y_px,
                rho=simulated.optical_rho,
                corner_sigma_gain=simulated.corner_sigma_gain,
                focal_length_mm=optics.focal_length_mm,
                f_number=simulated.f_number,
                pixel_pitch_um=optics.pixel_pitch_um,
                focus_distance_mm=simulated.focus_distance_mm,
            )
        except ValueError as error:
            raise BenchConfigError(f"simulated: {error}") from error
        self.sensor = Sensor(
            white_e_per_us=simulated.white_e_per_us,
            gain_e_per_dn=simulated.gain_e_per_dn,
            read_noise_e=simulated.read_noise_e,
            full_well_e=simulated.full_well_e,
            black_level_dn=simulated.black_level_dn,
        )
        self._illumination = Illumination(
            vignetting=simulated.vignetting,
            gloss=simulated.gloss,
            shadow=simulated.shadow,
            dimming_per_100mm=simulated.dimming_per_100mm,
        )
        self._pixel_format = config.camera.pixel_format
        self.renderer = Renderer(self.camera, self.lens)
        self._views: OrderedDict[tuple[str, float, CameraPose], NDArray[np.float32]] = OrderedDict()

    @property
    def read_noise_e(self) -> float:
        """Standard deviation of the dark noise, in electrons."""
        return self.sensor.read_noise_e

    @property
    def black_level_dn(self) -> float:
        """Offset in DN at 12 bits."""
        return self.sensor.black_level_dn

    def gain_e_per_dn(self, gain_db: float = 0.0) -> float:
        """Electrons per 12-bit DN."""
        return self.sensor.gain_at_e_per_dn(gain_db)

    def optical_covariance_px2(
        self, height_mm: float, x_px: float | None = None, y_px: float | None = None
    ) -> NDArray[np.float64]:
        """PSF of the optics, including defocus, at a pixel, by default at the image centre."""
        centre_x, centre_y = self.camera.centre_px
        radius = self.camera.relative_radius(
            np.asarray(centre_x if x_px is None else x_px),
            np.asarray(centre_y if y_px is None else y_px),
        )
        return self.lens.covariance_px2(self.camera.distance_mm(height_mm), float(radius))

    def total_covariance_px2(
        self, height_mm: float, x_px: float | None = None, y_px: float | None = None
    ) -> NDArray[np.float64]:
        """PSF of optics and pixel square together, at a pixel, by default at the image centre."""
        return self.optical_covariance_px2(height_mm, x_px, y_px) + PIXEL_VARIANCE_PX2 * np.eye(2)

    def scale_px_per_mm(self, height_mm: float) -> float:
        """Pixels per millimetre of the plane at the image centre, for an upright camera."""
        return self.camera.scale_px_per_mm(height_mm)

    def zoom(self, near_height_mm: float, far_height_mm: float) -> float:
        """Zoom-out: ratio of the distances from the entrance pupil."""
        return self.camera.distance_mm(far_height_mm) / self.camera.distance_mm(near_height_mm)

    def homography_far_to_near(
        self, near: CameraPose | float, far: CameraPose | float
    ) -> NDArray[np.float64]:
        """Matrix from ideal far pixels to ideal near pixels, last entry 1; no distortion.

        Of poses, or of heights in mm of an upright camera.
        """
        near_pose, far_pose = (
            pose if isinstance(pose, CameraPose) else CameraPose(height_mm=pose)
            for pose in (near, far)
        )
        matrix = self.camera.homography_to_px(near_pose) @ np.linalg.inv(
            self.camera.homography_to_px(far_pose)
        )
        return np.asarray(matrix / matrix[2, 2])

    def place_errors_px(
        self, pose: _FoundPose, near_mm: float, far_mm: float
    ) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Distances in the reference between true pixel positions and those given by a pose.

        Of a follow-up relative to its reference, both from an upright camera at these heights; for
        every fifth follow-up pixel along both axes that the reference shows.
        """
        rows, cols = pose.followup_shape
        y, x = np.mgrid[0:rows:_TRUTH_STEP_PX, 0:cols:_TRUTH_STEP_PX].astype(np.float64)
        on_plane = self.camera.to_plane_mm(x, y, CameraPose(height_mm=far_mm))
        true_x, true_y = self.camera.to_pixel(*on_plane, CameraPose(height_mm=near_mm))
        found_y, found_x = pose.to_reference_px(y, x)
        shown = (
            (true_x > _BORDER_PX)
            & (true_x < pose.reference_shape[1] - 1 - _BORDER_PX)
            & (true_y > _BORDER_PX)
            & (true_y < pose.reference_shape[0] - 1 - _BORDER_PX)
        )
        return np.asarray(np.hypot(found_x - true_x, found_y - true_y)[shown])

    def seen_height_mm(
        self, target: str, orientation_deg: float, pose: CameraPose
    ) -> NDArray[np.float64]:
        """Height above the plane of what each pixel's centre sees, shape (rows, cols).

        0 of a flat target, NaN of the walls of things that stand on one.
        """
        x_px = np.arange(self.camera.width_px, dtype=np.float64)[None, :]
        y_px = np.arange(self.camera.height_px, dtype=np.float64)[:, None]
        placed = Placed(scene=scene_of(target), angle_deg=orientation_deg).seen_from(
            pose.offset_x_mm, pose.offset_y_mm, self.camera.distance_mm(pose.height_mm)
        )
        x_mm, y_mm = placed.own_mm(*self.camera.to_plane_mm(x_px, y_px, pose))
        if not isinstance(placed.scene, SeenRelief):
            return np.zeros(np.broadcast_shapes(x_mm.shape, y_mm.shape))
        return placed.scene.height_mm(x_mm, y_mm)

    def irradiance(
        self, target: str, orientation_deg: float, pose: CameraPose
    ) -> NDArray[np.float32]:
        """Mean light on each pixel, relative to white paper, read-only, shape (rows, cols).

        The last views are cached, so that the frames of one capture cost one rendering. ValueError,
        which lists them, if there is no such target.
        """
        key = (target, orientation_deg, pose)
        if key not in self._views:
            scene = Placed(scene=scene_of(target), angle_deg=orientation_deg)
            view = self.renderer.irradiance(scene, pose)
            if TARGETS[target].kind != "dark":
                view = self._illumination.lit(view, self.camera, pose)
            view.setflags(write=False)
            self._views[key] = view
            while len(self._views) > VIEWS_KEPT:
                self._views.popitem(last=False)
        self._views.move_to_end(key)
        return self._views[key]

    def expected_image_dn(
        self,
        target: str,
        orientation_deg: float,
        pose: CameraPose | float,
        *,
        exposure_us: float,
        gain_db: float = 0.0,
    ) -> NDArray[np.float64]:
        """Mean image without noise and rounding, in DN of the bench's pixel format, (rows, cols).

        Target and orientation as for `SimulatedBench.place`; a pose, or the height in mm of an
        upright camera; exposure and gain as the camera reads them back. Clipped as the camera's
        levels are.
        """
        pose = pose if isinstance(pose, CameraPose) else CameraPose(height_mm=pose)
        light = self.irradiance(target, orientation_deg, pose)
        return self.sensor.expected_dn(light, exposure_us, gain_db, self._pixel_format)
