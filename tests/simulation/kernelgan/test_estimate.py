"""The kernel that KernelGAN finds, its crops, and images sampled through it."""

import importlib.machinery
import importlib.util
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from simulation import GaussianPsf, SamplingGrid, zoom_out_image
from simulation.arrays import FloatArray
from simulation.kernelgan import (
    CropPicker,
    EstimatedKernel,
    KernelGanError,
    KernelGanSettings,
    estimate_kernel,
    kernel_operator,
)
from simulation.kernelgan._crops import OUTPUT_SIDE_PX, TorchMissingError, _nearest_positions
from simulation.kernelgan._estimate import KERNEL_SIZE, centre_half
from tests.simulation.dead_leaves import dead_leaves

NOISE = np.random.default_rng(0).uniform(0, 4000, (90, 100))


def _variance_px2(image: FloatArray, **settings: Any) -> float:
    kernel = estimate_kernel(image, KernelGanSettings(zoom=2.0, **settings))
    return float(np.trace(kernel.covariance_px2)) / 2


def test_moments_of_a_kernel_by_hand() -> None:
    weights = np.zeros((13, 13))
    weights[6, 6:9] = 0.5, 0.25, 0.25  # x: 0, 1, 2
    kernel = EstimatedKernel(weights=weights)
    assert kernel.centre_px == pytest.approx((0.0, 0.75))
    # Mean square 1.25, less the square of the mean.
    expected = np.array([[0.6875, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(kernel.covariance_px2, expected, atol=1e-15)


@pytest.mark.parametrize("weights", [np.full((13, 13), 1.0), np.full((13, 13), np.nan)])
def test_a_kernel_that_does_not_add_up_to_1_is_refused(weights: FloatArray) -> None:
    with pytest.raises(ValueError):
        EstimatedKernel(weights=weights)


@pytest.mark.parametrize(
    "wrong",
    [{"zoom": 0.5}, {"zoom": float("nan")}, {"steps": 0}, {"seed": -1}, {"model": "matched"}],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    right: dict[str, Any] = {"zoom": 2.0}
    assert KernelGanSettings(**right).zoom == 2.0
    with pytest.raises(ValueError):
        KernelGanSettings(**(right | wrong))


def test_nearest_positions_by_hand() -> None:
    # 0.75, 2.25, 3.75, 5.25 and 1, 3, 5
    np.testing.assert_array_equal(_nearest_positions(4, 1.5), [0, 2, 3, 5])
    np.testing.assert_array_equal(_nearest_positions(3, 2.0), [1, 3, 5])


def test_crops_are_drawn_where_the_gradient_is() -> None:
    image = np.zeros((100, 200))
    image[:, 150:] = np.random.default_rng(1).uniform(0, 1, (100, 50))
    picker = CropPicker.of_image(image, 2.0, KERNEL_SIZE)
    rng = np.random.default_rng(2)
    crops = [picker.generator_crop(rng) for _ in range(50)]
    assert all(crop.shape == (63, 63) for crop in crops)  # 25 * 2 + 13
    assert all(crop.any() for crop in crops)
    assert picker.real_crop(rng).shape == (OUTPUT_SIDE_PX, OUTPUT_SIDE_PX)


def test_zoom_1_needs_no_training() -> None:
    kernel = estimate_kernel(NOISE, KernelGanSettings(zoom=1.0))
    np.testing.assert_array_equal(kernel.covariance_px2, 0.0)


@pytest.mark.parametrize(
    ("image", "is_centre_crop", "reason"),
    [
        pytest.param(np.full((90, 90), 7.0), False, "flat", id="flat"),
        pytest.param(NOISE[:62], False, "too_small", id="small"),
        pytest.param(NOISE, True, "too_small", id="small in the middle"),
    ],
)
def test_an_image_that_teaches_nothing_is_refused_with_the_reason(
    image: FloatArray, is_centre_crop: bool, reason: str
) -> None:
    settings = KernelGanSettings(zoom=2.0, steps=1, is_centre_crop=is_centre_crop)
    with pytest.raises(KernelGanError) as refused:
        estimate_kernel(image, settings)
    assert refused.value.reason == reason


@pytest.mark.parametrize("image", [np.dstack([NOISE] * 3), np.where(NOISE > 3000, np.nan, NOISE)])
def test_colours_and_values_that_are_not_finite_are_refused(image: FloatArray) -> None:
    with pytest.raises(ValueError):
        estimate_kernel(image, KernelGanSettings(zoom=2.0, steps=1))


def test_the_centre_half_is_centred() -> None:
    assert centre_half(np.zeros((5, 8))).shape == (3, 4)
    np.testing.assert_array_equal(centre_half(np.arange(64.0).reshape(8, 8))[0], [18, 19, 20, 21])


def test_without_torch_the_error_is_one_of_a_missing_module(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = importlib.util.find_spec

    def blocked(name: str, package: str | None = None) -> importlib.machinery.ModuleSpec | None:
        return None if name == "torch" else real(name, package)

    monkeypatch.setattr("simulation.kernelgan._estimate.find_spec", blocked)
    with pytest.raises(TorchMissingError):
        estimate_kernel(NOISE, KernelGanSettings(zoom=2.0))


@pytest.mark.slow
@pytest.mark.parametrize("model", ["kernelgan", "gaussian-kernelgan"])
def test_a_seed_gives_one_kernel_which_adds_up_to_1(model: Any) -> None:
    def trained(seed: int) -> FloatArray:
        settings = KernelGanSettings(zoom=1.5, model=model, steps=4, seed=seed)
        return estimate_kernel(NOISE, settings).weights

    first = trained(3)
    assert first.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_array_equal(trained(3), first)
    assert np.any(trained(4) != first)


@pytest.mark.slow
def test_training_leaves_the_global_random_state_and_the_threads_alone() -> None:
    torch = pytest.importorskip("torch")
    before, threads = torch.random.get_rng_state(), torch.get_num_threads()
    estimate_kernel(NOISE, KernelGanSettings(zoom=2.0, steps=2))
    assert torch.equal(torch.random.get_rng_state(), before)
    assert torch.get_num_threads() == threads


@pytest.mark.slow
def test_progress_ends_at_the_number_of_steps() -> None:
    told: list[int] = []
    estimate_kernel(
        NOISE, KernelGanSettings(zoom=2.0, model="gaussian-kernelgan", steps=5), told.append
    )
    assert told == [1, 2, 3, 4, 5]


@pytest.mark.slow
def test_a_short_training_tells_a_soft_image_from_a_sharp_one() -> None:
    # True variances added at zoom 2: 3 sigma^2; the training starts at 1 px^2, its width zoom / 2.
    # Asserted is the order, and that both come nearer to the truth, not how near: 200 of 3000
    # steps still wander.
    estimates = {}
    for sigma_px in (0.4, 1.0):
        image = dead_leaves((120, 140), sigma_px, seed=1)
        estimates[sigma_px] = _variance_px2(image, model="gaussian-kernelgan", steps=200)
        true_px2 = 3 * sigma_px**2
        assert abs(estimates[sigma_px] - true_px2) < abs(1.0 - true_px2)
    assert estimates[1.0] > 2 * estimates[0.4]


def test_a_kernel_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError):
        EstimatedKernel(weights=np.full((11, 11), 1 / 121))


SHAPE = (60, 90)
OFFSET = np.arange(13) - 6.0


def _gaussian(variance_px2: float, centre: tuple[float, float] = (0.0, 0.0)) -> EstimatedKernel:
    y, x = (np.exp(-0.5 * (OFFSET - c) ** 2 / variance_px2) for c in centre)
    weights = np.outer(y, x)
    return EstimatedKernel(weights=weights / weights.sum())


def _blobs() -> FloatArray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    made = np.zeros(SHAPE)
    for cy, cx in ((20.3, 31.8), (41.0, 60.4), (28.7, 52.2)):
        made += np.exp(-((y - cy) ** 2 + (x - cx) ** 2) / (2 * 2.5**2))
    return made


def test_nearest_equals_a_correlation_sampled_at_the_published_positions() -> None:
    rng = np.random.default_rng(0)
    weights = rng.uniform(0, 1, (13, 13))
    kernel = EstimatedKernel(weights=weights / weights.sum())
    image = rng.uniform(0, 1, SHAPE)
    for zoom in (2.0, 1.5, 3.0):  # all divide 60 and 90
        made = kernel_operator(SHAPE, SamplingGrid.centred(SHAPE, zoom), kernel, "nearest")
        blurred = ndimage.correlate(image, kernel.weights, mode="reflect")
        rows, cols = (_nearest_positions(int(size / zoom), zoom) for size in SHAPE)
        np.testing.assert_allclose(made.apply(image), blurred[np.ix_(rows, cols)], atol=1e-10)


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.8, -1.3)])
@pytest.mark.parametrize("zoom", [2.0, 1.3])
def test_exact_has_the_geometry_of_the_other_models_wherever_the_kernel_lies(
    zoom: float, centre: tuple[float, float]
) -> None:
    psf = GaussianPsf(sigma_x_px=1.0, sigma_y_px=1.0)
    kernel = _gaussian(zoom**2 - 1, centre)
    grid = SamplingGrid.centred(SHAPE, zoom)
    made = kernel_operator(SHAPE, grid, kernel).apply(_blobs())
    # The kernel ends at 6 px, 3.5 of its sigmas and less where it is off centre.
    np.testing.assert_allclose(made, zoom_out_image(_blobs(), zoom, psf), atol=0.01)


def test_a_constant_stays_constant_and_zoom_1_changes_nothing() -> None:
    weights = np.zeros((13, 13))
    weights[6, 6] = 1.0
    for sampler in ("exact", "nearest"):
        grid = SamplingGrid.centred(SHAPE, 2.3)
        level = kernel_operator(SHAPE, grid, _gaussian(2.0, (0.4, 0.1)), sampler)
        np.testing.assert_allclose(level.apply(np.full(SHAPE, 7.0)), 7.0, rtol=1e-10)
        same = kernel_operator(
            SHAPE,
            SamplingGrid.centred(SHAPE, 1.0),
            EstimatedKernel(weights=weights),
            sampler,
        )
        np.testing.assert_allclose(same.apply(_blobs()), _blobs(), atol=1e-5)


def test_an_unknown_sampler_is_refused() -> None:
    sampler: Any = "cubic"
    with pytest.raises(ValueError):
        kernel_operator(SHAPE, SamplingGrid.centred(SHAPE, 2.0), _gaussian(1.0), sampler)
