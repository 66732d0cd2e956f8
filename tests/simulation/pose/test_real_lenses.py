"""Any lens from any pose, against a renderer that shares nothing with the model.

Opaque slanted rectangles are drawn eight times as fine as the pixels, through a homography and a
distortion that are written here, and seen through optical transfer functions by a discrete Fourier
transform. The circular pupil's transfer is the closed form in focus.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest

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
from simulation.choices import PoseModel
from simulation.pose import pose_noise_gain
from tests.simulation.poses import tilted

FINE = 6
PAD_PX = 14
SIZE = (100, 84)
FOCAL_PX = 120.0
MARGIN_PX = 14

Otf = Callable[[FloatArray, FloatArray], FloatArray]
Warp = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class Pupil:
    """A lens in focus over square pixels: cut-off periods along two axes, turned."""

    first_px: float
    second_px: float
    turn_deg: float = 0.0

    def otf(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Transfer, by the closed form of a circular pupil."""
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        nu = np.hypot(self.first_px * (c * fx + s * fy), self.second_px * (c * fy - s * fx))
        nu = np.minimum(nu, 1.0)
        lens = 2 / np.pi * (np.arccos(nu) - nu * np.sqrt(1 - nu * nu))
        return np.asarray(lens * np.sinc(fx) * np.sinc(fy))

    @property
    def psf(self) -> MeasuredPsf:
        """The same lens as the model takes it, with the Gaussian that agrees at 0.2 cy/px."""
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        turn = np.array([[c, -s], [s, c]])
        (xx, xy), (_, yy) = turn @ np.diag([self.first_px, self.second_px]) @ turn.T
        along = np.array([[1.0, 0.0], [0.0, 1.0], [0.5**0.5, 0.5**0.5]])
        transfer = self.otf(0.2 * along[:, 0], 0.2 * along[:, 1])
        var_x, var_y, var_d = -np.log(transfer) / (2 * np.pi**2 * 0.04)
        covariance = var_d - (var_x + var_y) / 2
        return MeasuredPsf(
            lens=LensOtf(cut_off_period_px=(float(xx), float(xy), float(yy))),
            gaussian=GaussianPsf.from_covariance(
                np.array([[var_x, covariance], [covariance, var_y]])
            ),
        )


def scene(x: FloatArray, y: FloatArray, pitch: FloatArray) -> FloatArray:
    """Opaque rectangles of 20-235 DN at scene positions; edges are as soft as the sampling."""
    rng = np.random.default_rng(8)
    level = np.full(x.shape, 128.0)
    for _ in range(36):
        at, angle = rng.uniform(-60, 60, 2), rng.uniform(0, np.pi)
        half, shade = rng.uniform(4, 26, 2), rng.uniform(20, 235)
        along = np.cos(angle) * (x - at[0]) + np.sin(angle) * (y - at[1])
        across = np.cos(angle) * (y - at[1]) - np.sin(angle) * (x - at[0])
        inside = np.clip(0.5 + (half[0] - np.abs(along)) / pitch, 0, 1) * np.clip(
            0.5 + (half[1] - np.abs(across)) / pitch, 0, 1
        )
        level += inside * (shade - level)
    return level


def rendered(to_scene: Warp, otf: Otf) -> FloatArray:
    """What a camera sees whose pixels look at the scene through ``to_scene``."""
    width, height = (size + 2 * PAD_PX for size in SIZE)
    x, y = np.meshgrid(
        (np.arange(width * FINE) - (FINE - 1) / 2) / FINE - PAD_PX,
        (np.arange(height * FINE) - (FINE - 1) / 2) / FINE - PAD_PX,
    )
    scene_x, scene_y = to_scene(x, y)
    pitch = np.sqrt(
        np.abs(
            np.gradient(scene_x, axis=1) * np.gradient(scene_y, axis=0)
            - np.gradient(scene_x, axis=0) * np.gradient(scene_y, axis=1)
        )
    )
    sharp = scene(scene_x, scene_y, pitch)
    fx = np.fft.rfftfreq(width * FINE, 1 / FINE)[None, :].astype(np.float64)
    fy = np.fft.fftfreq(height * FINE, 1 / FINE)[:, None].astype(np.float64)
    # The edges' own softness is a fine pixel's; pixel centres lie between fine pixels.
    transfer = otf(fx, fy) / (np.sinc(fx / FINE) * np.sinc(fy / FINE))
    shift = np.exp(2j * np.pi * (fx + fy) * (FINE - 1) / 2 / FINE)
    seen = np.fft.irfft2(np.fft.rfft2(sharp) * transfer * shift, sharp.shape)
    first = PAD_PX * FINE
    return np.asarray(seen[first:-first:FINE, first:-first:FINE])


MIDDLE = (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2
CORNER_PX = float(np.hypot(*MIDDLE))


def through(matrix: FloatArray, k1: float = 0.0) -> Warp:
    """Warp from a follow-up's pixels to the scene: the ideal reference about its middle."""

    def warp(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        dx, dy = x - MIDDLE[0], y - MIDDLE[1]
        seen = np.hypot(dx, dy) / CORNER_PX
        ideal = seen
        for _ in range(60):
            ideal = seen / (1 + k1 * ideal**2)
        scale = np.where(seen > 0, ideal / np.maximum(seen, 1e-12), 1.0)
        dx, dy = MIDDLE[0] + scale * dx, MIDDLE[1] + scale * dy
        depth = matrix[2, 0] * dx + matrix[2, 1] * dy + matrix[2, 2]
        return (
            (matrix[0, 0] * dx + matrix[0, 1] * dy + matrix[0, 2]) / depth - MIDDLE[0],
            (matrix[1, 0] * dx + matrix[1, 1] * dy + matrix[1, 2]) / depth - MIDDLE[1],
        )

    return warp


def view(zoom: float, tilt_deg: float, turn_deg: float = 0.0) -> FloatArray:
    """Homography of a camera that leans towards +x and is turned about its axis."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    about = np.array([[1, 0, MIDDLE[0]], [0, 1, MIDDLE[1]], [0, 0, 1.0]])
    turned = about @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.linalg.inv(about)
    return np.asarray(tilted(FOCAL_PX, SIZE, tilt_deg, zoom) @ turned)


@lru_cache
def pair(
    lens: Pupil, zoom: float, tilt_deg: float, turn_deg: float, k1: float
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Homography, reference, follow-up, and where it lies well inside the reference."""
    matrix = view(zoom, tilt_deg, turn_deg)
    reference = rendered(through(np.eye(3), k1), lens.otf)
    follow_up = rendered(through(matrix, k1), lens.otf)
    x, y = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    scene_x, scene_y = through(matrix, k1)(x, y)
    inner = (np.abs(scene_x) < MIDDLE[0] - MARGIN_PX) & (np.abs(scene_y) < MIDDLE[1] - MARGIN_PX)
    return matrix, reference, follow_up, inner


def mse(
    lens: Pupil,
    pose: tuple[float, float, float, float],
    psf: Psf | PsfField,
    model: PoseModel = "lmmse",
) -> float:
    matrix, reference, follow_up, inner = pair(lens, *pose)
    made = simulate_pose_of_image(
        reference, matrix, SIZE, psf, PoseOptions(distortion_k1=pose[3], model=model)
    )
    used = inner & ~made.nearer & ~made.outside
    assert used.sum() > 500
    return float(np.mean((made.image - follow_up)[used] ** 2))


F_2_8, F_11 = Pupil(0.1855, 0.1855), Pupil(0.7289, 0.7289)
ASTIGMATIC = Pupil(0.75, 0.4, 30.0)
"""Cut-off periods: 550 nm times the f-number over pixels of 8.3 um, and one that is elliptic."""

TILT, TILTED_TURN, DISTORTED = (
    (2.0, 30.0, 0.0, 0.0),
    (1.5, 25.0, 20.0, 0.0),
    (2.0, 10.0, 40.0, 0.01),
)
"""Zoom, tilt and turn in degrees, distortion."""


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matched", "lmmse"])
@pytest.mark.parametrize(
    ("lens", "pose"), [(F_11, TILT), (ASTIGMATIC, TILTED_TURN), (ASTIGMATIC, DISTORTED)]
)
def test_a_soft_lens_needs_its_own_transfer_function(
    lens: Pupil, pose: tuple[float, float, float, float], model: PoseModel
) -> None:
    own, gaussian = mse(lens, pose, lens.psf, model), mse(lens, pose, lens.psf.gaussian, model)
    # Measured: .014-.13 against 1.3-2.4 DN^2. The least gain, of the astigmatic lens, is tenfold.
    assert own < 0.15
    assert own < gaussian / 8


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matched", "lmmse"])
@pytest.mark.parametrize(
    ("pose", "bound_dn2"), [(TILT, 0.16), (TILTED_TURN, 0.72), (DISTORTED, 0.19)]
)
def test_a_sharp_lens_is_left_with_what_it_has_aliased(
    pose: tuple[float, float, float, float], bound_dn2: float, model: PoseModel
) -> None:
    # Measured .12, .57 and .15 DN^2; with the nearest Gaussian .52, .91 and .70.
    assert mse(F_2_8, pose, F_2_8.psf, model) < bound_dn2


def test_turning_an_astigmatic_lens_the_wrong_way_shows() -> None:
    wrong = Pupil(ASTIGMATIC.first_px, ASTIGMATIC.second_px, -ASTIGMATIC.turn_deg)
    # Measured .64 against .13 DN^2.
    right = mse(ASTIGMATIC, TILTED_TURN, ASTIGMATIC.psf)
    assert mse(ASTIGMATIC, TILTED_TURN, wrong.psf) > 4 * right


@pytest.mark.parametrize("model", ["matched", "lmmse"])
def test_a_field_of_one_measured_shape_is_that_lens(model: PoseModel) -> None:
    matrix, reference, _, _ = pair(ASTIGMATIC, *TILTED_TURN)
    (xx, xy), (_, yy) = ASTIGMATIC.psf.covariance_px2.tolist()
    field = PsfField(
        width_px=SIZE[0],
        height_px=SIZE[1],
        coefficients_px2=np.array([[xx], [xy], [yy]]),
        shape=ASTIGMATIC.psf,
    )
    one = simulate_pose_of_image(reference, matrix, SIZE, ASTIGMATIC.psf, PoseOptions(model=model))
    even = simulate_pose_of_image(reference, matrix, SIZE, field, PoseOptions(model=model))
    # The shape's stretch is the identity but for rounding: 1.3e-6 or 4.5e-6 DN by processor.
    np.testing.assert_allclose(even.image, one.image, rtol=0, atol=2e-5)
    np.testing.assert_array_equal(even.nearer, one.nearer)


@pytest.mark.slow
def test_a_shift_over_a_field_goes_from_one_shape_to_the_other() -> None:
    # The lens grows softer to the right; the follow-up looks 30 px further left with its soft end.
    lens = Pupil(0.9, 0.9)
    shift = np.array([[1.0, 0, -30.0], [0, 1, 0], [0, 0, 1]])
    middle_px2, slope_px2 = 0.42, 0.4
    coefficients = np.zeros((3, 3))
    coefficients[[0, 2], 0], coefficients[[0, 2], 1] = middle_px2, slope_px2
    field = PsfField(
        width_px=SIZE[0], height_px=SIZE[1], coefficients_px2=coefficients, shape=lens.psf
    )
    reference = rendered(through(np.eye(3)), field.at(35.0, MIDDLE[1]).otf)
    follow_up = rendered(through(shift), field.at(65.0, MIDDLE[1]).otf)
    made = simulate_pose_of_image(reference, shift, SIZE, field, PoseOptions(model="lmmse"))
    near = np.s_[20:-20, 63:68]
    error = float(np.mean((made.image - follow_up)[near] ** 2))
    unblurred = float(np.mean((reference[20:-20, 33:38] - follow_up[near]) ** 2))
    # Truth is right in the middle of these columns alone: 2 px away it is off by a tenth.
    assert error < 0.05 * unblurred


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matched", "lmmse"])
def test_noise_is_passed_on_as_the_gain_says(model: PoseModel) -> None:
    matrix = view(1.5, 25.0, 20.0)
    rng = np.random.default_rng(3)
    gain = pose_noise_gain(matrix, SIZE[::-1], SIZE, ASTIGMATIC.psf, PoseOptions(model=model))
    squares = np.mean(
        [
            simulate_pose_of_image(
                rng.standard_normal(SIZE[::-1]),
                matrix,
                SIZE,
                ASTIGMATIC.psf,
                PoseOptions(model=model),
            ).image
            ** 2
            for _ in range(150)
        ],
        axis=0,
    )
    inner = pair(ASTIGMATIC, *TILTED_TURN)[3]
    # 150 draws of some 500 pixels with correlated neighbours: known to about 1 %.
    assert float(np.mean((squares / gain)[inner])) == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_noise_that_is_stated_is_passed_on_less() -> None:
    matrix, size = view(1.3, 10.0), SIZE[::-1]
    gains = [
        pose_noise_gain(
            matrix, size, SIZE, F_2_8.psf, PoseOptions(model="lmmse", noise_ratio=ratio)
        ).mean()
        for ratio in (0.0, 0.01, 0.1)
    ]
    assert gains[0] > gains[1] > gains[2]


def test_two_threads_give_the_same_bits() -> None:
    image = np.random.default_rng(2).uniform(0, 255, (300, 1100)).astype(np.float32)
    matrix = tilted(900.0, (1100, 300), 10.0, 1.2)
    one, two = (
        simulate_pose_of_image(image, matrix, (1100, 300), F_11.psf, PoseOptions(threads=threads))
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(two.image, one.image)
    np.testing.assert_array_equal(two.nearer, one.nearer)


def test_wrong_options_are_refused() -> None:
    image = np.zeros((40, 50))
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, np.eye(3), (50, 40), F_11.psf, PoseOptions(model="paper"))  # type: ignore[arg-type]
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, np.eye(3), (50, 40), F_11.psf, PoseOptions(noise_ratio=-1.0))
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, np.eye(3), (50, 40), F_11.psf, PoseOptions(threads=0))
