from typing import Any

import numpy as np
import pytest

from simulation import GaussianPsf, PoseOptions, PsfField, SamplingGrid
from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise
from simulation.followup import (
    CaptureOptions,
    FollowUp,
    Rendering,
    captured,
    from_pose,
    zoomed_out,
)

NOISE = CaptureNoise(gain_e_per_dn=4.0, read_noise_e=8.0, black_level_dn=64.0)
PSF = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)


LOOKS = {
    "zoom": lambda image, noise: zoomed_out(image, 2.0, PSF, "matched", Rendering(noise=noise)),
    "pose": lambda image, noise: from_pose(
        image, *pose_of_zoom(image.shape, 2.0), PSF, PoseOptions(model="matched"), noise
    ),
}


def pose_of_zoom(shape: tuple[int, int], zoom: float) -> tuple[FloatArray, tuple[int, int]]:
    grid = SamplingGrid.centred(shape, zoom)
    return grid.matrix, (grid.cols, grid.rows)


@pytest.mark.slow
@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize(("exposure", "vignetting"), [(1.0, 0.0), (1.6, 0.0), (1.0, 0.6)])
def test_the_noise_is_that_of_the_light_that_arrives(
    exposure: float, vignetting: float, look: str
) -> None:
    rng = np.random.default_rng(2)
    level = np.full((300, 300), 1064.0)
    reference = level + np.sqrt(NOISE.variance_dn2(level)) * rng.standard_normal(level.shape)
    clean = captured(
        LOOKS[look](level, None), CaptureOptions(exposure=exposure, vignetting=vignetting)
    )
    options = CaptureOptions(exposure=exposure, vignetting=vignetting, seed=3)
    noisy = captured(LOOKS[look](reference, NOISE), options, NOISE)
    inner = np.s_[10:-10, 10:-10]
    # The clean image was lit without a black level; light it as the noisy one.
    expected_level = (clean / 1064.0) * 1000.0 + 64.0
    normalised = (noisy - expected_level) / np.sqrt(NOISE.variance_dn2(expected_level))
    assert np.mean(normalised[inner]) == pytest.approx(0.0, abs=0.05)
    assert np.var(normalised[inner]) == pytest.approx(1.0, rel=0.06)  # 16 900 pixels


def test_without_options_nothing_changes() -> None:
    image = np.random.default_rng(0).uniform(0, 9, (20, 30))
    followup = FollowUp(image=image, own_variance_dn2=None)
    np.testing.assert_array_equal(captured(followup, CaptureOptions()), image)


@pytest.mark.parametrize("shape", [(80, 121), (81, 120)])
def test_a_field_is_taken_at_the_middle_of_the_camera_s_frame(shape: tuple[int, int]) -> None:
    # Even as a field, so that the plain zoom-out is the truth; odd sizes leave half a pixel.
    (xx, xy), (_, yy) = PSF.covariance_px2
    even = PsfField(
        width_px=shape[1], height_px=shape[0], coefficients_px2=np.array([[xx], [xy], [yy]])
    )
    image = np.random.default_rng(1).uniform(0, 255, shape)
    plain = zoomed_out(image, 1.7, PSF, "matched")
    field = zoomed_out(image, 1.7, even, "matched")
    assert field.is_field
    # White noise, and two kernels that end at different places: 0.28 of 255.
    assert field.image == pytest.approx(plain.image, abs=1.5e-3 * 255)
    with pytest.raises(ValueError, match="model"):
        zoomed_out(image, 1.7, even, "paper")


@pytest.mark.parametrize(
    "values",
    [
        {"exposure": float("inf")},
        {"exposure": -1.0},
        {"vignetting": 1.0},
        {"vignetting": float("nan")},
        {"sharpening": (float("nan"), 1.0)},
        {"sharpening": (0.8, 0.0)},
    ],
)
def test_options_out_of_range_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="got"):
        CaptureOptions(**values)
