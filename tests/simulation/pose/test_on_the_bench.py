"""The pose model against the simulated bench, which shares no code with it."""

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
import pytest

from acquisition.bench import BenchConfig
from hil_mocks.truth.bench_truth import BenchTruth
from hil_mocks.truth.render import CameraPose
from simulation import (
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    PoseOptions,
    Psf,
    PsfField,
    simulate_pose_of_image,
)
from simulation.arrays import BoolArray, FloatArray
from simulation.choices import DEFAULT_MODEL, PoseModel

pytestmark = pytest.mark.slow

SIZE = (320, 240)
NEAR_MM = 200.0
EXPOSURE_US = 8000.0
TILT_DEG = 20.0
MARGIN_PX = 12
"""Around the reference: the simulation mirrors there what the real follow-up sees."""


def truth_of(**simulated: float) -> BenchTruth:
    """A bench of 320 x 240 pixels that sees as much, and as obliquely, as one of 780 x 580."""
    return BenchTruth(
        BenchConfig.model_validate(
            {
                "camera": {
                    "driver": "simulated",
                    "pixel_format": "Mono12",
                    "exposure_us": EXPOSURE_US,
                    "gain_db": 0.0,
                    "frame_rate_hz": 50.0,
                },
                "stage": {
                    "driver": "simulated",
                    "limits_mm": [10.0, 800.0],
                    "feed_mm_per_min": 1200.0,
                    "settle_s": 0.5,
                },
                "optics": {"focal_length_mm": 8.0, "pixel_pitch_um": 20.0},
                "simulated": {"width_px": SIZE[0], "height_px": SIZE[1], "full_well_e": 30000.0}
                | simulated,
            }
        )
    )


def pose(truth: BenchTruth, zoom: float, tilt_deg: float, bearing_deg: float = 0.0) -> CameraPose:
    """Pose that looks at the reference's centre from ``zoom`` times its distance."""
    near_mm = truth.camera.distance_mm(NEAR_MM)
    lean, bearing = radians(tilt_deg), radians(bearing_deg)
    return CameraPose(
        height_mm=NEAR_MM - near_mm + zoom * near_mm * cos(lean),
        offset_x_mm=-zoom * near_mm * sin(lean) * cos(bearing),
        offset_y_mm=-zoom * near_mm * sin(lean) * sin(bearing),
        tilt_x_deg=tilt_deg * cos(bearing),
        tilt_y_deg=tilt_deg * sin(bearing),
    )


@dataclass(frozen=True)
class Judged:
    """Squared error against the bench, and the masks."""

    squared: FloatArray
    seen: BoolArray
    nearer: BoolArray

    @property
    def mse(self) -> float:
        """Where the follow-up is not nearer."""
        return float(self.squared[self.seen & ~self.nearer].mean())


def judged(
    truth: BenchTruth,
    target: str,
    far: CameraPose,
    psf: Psf | PsfField,
    distortion_k1: float = 0.0,
    model: PoseModel = DEFAULT_MODEL,
) -> Judged:
    near = CameraPose(height_mm=NEAR_MM)
    reference, follow_up = (
        truth.expected_image_dn(target, 0.0, at, exposure_us=EXPOSURE_US) for at in (near, far)
    )
    homography = truth.homography_far_to_near(near, far)
    simulated = simulate_pose_of_image(
        reference, homography, SIZE, psf, PoseOptions(distortion_k1=distortion_k1, model=model)
    )
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    places = homography @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    place_x, place_y = (places[:2] / places[2]).reshape(2, *x.shape)
    seen = (np.abs(place_x - (SIZE[0] - 1) / 2) < SIZE[0] / 2 - MARGIN_PX) & (
        np.abs(place_y - (SIZE[1] - 1) / 2) < SIZE[1] / 2 - MARGIN_PX
    )
    return Judged((simulated.image - follow_up) ** 2, seen, simulated.nearer)


def psf_of(truth: BenchTruth) -> GaussianPsf:
    return GaussianPsf.from_covariance(truth.total_covariance_px2(NEAR_MM))


@pytest.mark.parametrize("bearing_deg", [0.0, 30.0])
@pytest.mark.parametrize("zoom", [1.5, 2.0])
def test_a_tilted_follow_up_is_as_exact_as_a_frontal_one(zoom: float, bearing_deg: float) -> None:
    truth = truth_of()
    psf = psf_of(truth)
    tilted = judged(truth, "grass", pose(truth, zoom, TILT_DEG, bearing_deg), psf)
    frontal = judged(truth, "grass", pose(truth, zoom, 0.0), psf)
    assert tilted.seen.mean() > 0.15
    assert tilted.mse < 1.5 * frontal.mse


@pytest.mark.parametrize("k1", [-0.03, 0.03])
def test_a_lens_that_distorts_leaves_it_as_exact(k1: float) -> None:
    straight, bent = truth_of(), truth_of(k1=k1)
    far = pose(straight, 1.5, TILT_DEG, 30.0)
    plain = judged(straight, "grass", far, psf_of(straight))
    through_it = judged(bent, "grass", far, psf_of(bent), k1)
    not_told = judged(bent, "grass", far, psf_of(bent))
    assert through_it.mse < 1.5 * plain.mse
    assert not_told.mse > 5 * plain.mse


def test_the_mask_holds_the_places_that_no_blur_can_make_good() -> None:
    truth = truth_of()
    tilted = judged(truth, "grass", pose(truth, 1.0, TILT_DEG), psf_of(truth))
    assert 0.3 < tilted.nearer[tilted.seen].mean() < 0.7
    # Snapshot: 64 against 5.4 DN^2 of 12 bit.
    assert tilted.squared[tilted.seen & tilted.nearer].mean() > 5 * tilted.mse


@pytest.mark.parametrize("tilt_deg", [0.0, TILT_DEG])
def test_a_lens_soft_in_the_corners_needs_its_field(tilt_deg: float) -> None:
    # Soft enough that aliasing does not hide the field.
    gain = 0.5
    truth = truth_of(corner_sigma_gain=gain, optical_sigma_x_px=0.8, optical_sigma_y_px=0.8)
    centre = truth.total_covariance_px2(NEAR_MM)
    optical = truth.optical_covariance_px2(NEAR_MM)
    # (1 + gain (u^2 + v^2))^2 of the optics, and the pixel's own square.
    square, fourth = 2 * gain, gain**2
    growth = np.array(
        [0, 0, 0, square, 0, square, 0, 0, 0, 0, fourth, 0, 2 * fourth, 0, fourth], dtype=np.float64
    )
    elements = [(0, 0), (0, 1), (1, 1)]
    coefficients = np.array([optical[element] * growth for element in elements])
    coefficients[:, 0] += [centre[element] for element in elements]
    # The bench's lens is a Gaussian over square pixels.
    (xx, xy), (_, yy) = optical.tolist()
    shape = MeasuredPsf(lens=LensOtf(gaussian_px2=(xx, xy, yy)), gaussian=psf_of(truth))
    field = PsfField(
        width_px=SIZE[0], height_px=SIZE[1], coefficients_px2=coefficients, shape=shape
    )
    # The worked values of the bench itself, in a corner.
    assert field.covariance_px2(0.0, 0.0) == pytest.approx(
        truth.total_covariance_px2(NEAR_MM, 0.0, 0.0)
    )
    far = pose(truth, 1.2, tilt_deg)
    # The sampling of `lmmse` leaves 0.02 DN^2 of 12 bit here, a third of what the field is worth.
    with_field = judged(truth, "gravel", far, field, model="matched")
    without = judged(truth, "gravel", far, shape, model="matched")
    both = ~with_field.nearer & ~without.nearer & with_field.seen
    assert with_field.squared[both].mean() < 0.3 * without.squared[both].mean()
