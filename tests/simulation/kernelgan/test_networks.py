from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402 - behind importorskip
from torch.nn import functional  # noqa: E402

from simulation.kernelgan._crops import (  # noqa: E402
    CropPicker,
    KernelGanError,
    _nearest_positions,
)
from simulation.kernelgan._training import (  # noqa: E402
    DeepLinearGenerator,
    KernelGanTraining,
    _boundary_mask,
    _GaussianGenerator,
    _KernelRegulariser,
    _PatchDiscriminator,
    composed_kernel,
    sampled,
)


def _random(*shape: int, seed: int = 0) -> Tensor:
    rng = torch.Generator().manual_seed(seed)
    made: Tensor = torch.randn(shape, generator=rng, dtype=torch.float64)
    return made


@pytest.mark.parametrize("zoom", [2.0, 1.5, 2.7])
def test_the_composed_generator_equals_its_layers_forward_and_gradient(zoom: float) -> None:
    generator = DeepLinearGenerator(torch.Generator().manual_seed(1), 1.0, torch.float64)
    crop = _random(60, 60)
    taps = torch.from_numpy(_nearest_positions(12, zoom))
    judged = _random(12, 12, seed=2)

    def gradients(made: Tensor) -> list[Tensor]:
        loss = (made[0, 0] * judged).sum() + made.square().sum()
        return list(torch.autograd.grad(loss, generator.parameters))

    composed = sampled(crop, generator.kernel(), taps)
    layered = crop[None, None]
    for weight in generator.parameters:
        layered = functional.conv2d(layered, weight)
    layered = layered[:, :, taps][:, :, :, taps]
    assert composed.shape == layered.shape == (1, 1, 12, 12)
    torch.testing.assert_close(composed, layered, rtol=1e-10, atol=1e-10)
    for ours, theirs in zip(gradients(composed), gradients(layered), strict=True):
        scale = float(theirs.abs().max())
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-10 * max(scale, 1.0))


def test_layers_of_any_size_compose_in_their_order() -> None:
    # Random weights have no symmetry: a flip or a swap of the layers would show.
    shapes = [(3, 1, 2, 3), (4, 3, 3, 1), (1, 4, 1, 2)]
    layers = [_random(*shape, seed=place) for place, shape in enumerate(shapes)]
    image = _random(1, 1, 9, 11, seed=9)
    layered = image
    for weight in layers:
        layered = functional.conv2d(layered, weight)
    torch.testing.assert_close(
        functional.conv2d(image, composed_kernel(layers)), layered, rtol=1e-12, atol=1e-12
    )


def test_the_first_kernel_is_a_blur_of_13_px_that_adds_up_to_1() -> None:
    kernel = DeepLinearGenerator(torch.Generator().manual_seed(0), 1.0, torch.float64).kernel()
    assert kernel.shape == (13, 13)
    assert float(kernel.detach().sum()) == pytest.approx(1.0)


def test_the_gaussian_generator_is_the_closed_form() -> None:
    generator = _GaussianGenerator(1.0, torch.float64)
    sigma_y, sigma_x, rho = 1.2, 0.8, 0.3
    generator.log_sigma_px.data = torch.tensor([sigma_y, sigma_x], dtype=torch.float64).log()
    generator.atanh_rho.data = torch.tensor(np.arctanh(rho))
    kernel = generator.kernel().detach().numpy()
    offset = np.arange(13) - 6.0
    y, x = np.meshgrid(offset, offset, indexing="ij")
    covariance = [
        [sigma_y**2, rho * sigma_y * sigma_x],
        [rho * sigma_y * sigma_x, sigma_x**2],
    ]
    at = np.stack([y, x], axis=-1)
    closed = np.exp(-0.5 * np.einsum("ijk,kl,ijl->ij", at, np.linalg.inv(covariance), at))
    np.testing.assert_allclose(kernel, closed / closed.sum(), atol=1e-14)


def test_the_discriminator_sees_7_px_and_its_layers_have_unit_norm() -> None:
    judge = _PatchDiscriminator(torch.Generator().manual_seed(0), torch.float64)
    image = _random(1, 1, 20, 22)
    assert judge(image).shape == (1, 1, 14, 16)
    judge.normalise(200)
    for weight in judge.normalised_weights():
        matrix = weight.detach().reshape(weight.shape[0], -1)
        assert float(torch.linalg.matrix_norm(matrix, 2)) == pytest.approx(1.0, rel=1e-3)
    # The receptive field, without the batch's statistics: the first layer is the only wide one.
    assert [tuple(w.shape[2:]) for w in judge.weights] == [(7, 7), *[(1, 1)] * 6]


def test_without_its_layers_the_discriminator_passes_a_gradient_to_the_image_only() -> None:
    judge = _PatchDiscriminator(torch.Generator().manual_seed(0), torch.float64)
    image = _random(1, 1, 12, 12).requires_grad_()
    judge(image).sum().backward()  # type: ignore[no-untyped-call]
    assert image.grad is not None
    assert bool(image.grad.abs().sum() > 0)
    assert all(parameter.grad is None for parameter in judge.parameters)
    torch.testing.assert_close(judge(image), judge(image, judge.normalised_weights()))


def test_the_regulariser_prefers_a_centred_compact_kernel_of_sum_1() -> None:
    penalty = _KernelRegulariser(13, torch.float64)
    best = torch.zeros(13, 13, dtype=torch.float64)
    best[6, 6] = 1.0
    for worse in (
        1.5 * best,
        0.7 * best,
        best.roll(2, 0),
        best.roll(-2, 1),
        best.roll((6, 6), (0, 1)),
    ):
        assert float(penalty(worse)) > float(penalty(best))
    # One whole pixel off: delta times 1 px, and beta times the mask there.
    off = float(penalty(best.roll(1, 1)) - penalty(best))
    mask = float(_boundary_mask(13, torch.float64)[6, 7])
    assert off == pytest.approx(1.0 + 0.5 * mask, abs=2e-3)  # the root is rounded at 0


def test_the_boundary_mask_grows_to_1_in_the_corner() -> None:
    mask = _boundary_mask(13, torch.float64)
    assert float(mask[6, 6]) == 0.0
    assert float(mask[0, 0]) == 1.0
    along = mask[6, 6:].tolist()
    assert all(a < b for a, b in pairwise(along))


@pytest.mark.parametrize(
    ("kernel", "margin", "reason"),
    [
        (np.full((13, 13), np.nan), 0.0, "not_finite"),
        (np.full((13, 13), 3 / 169), 0.0, "wrong_sum"),
        (np.full((13, 13), 1 / 169), 0.95, "discriminator_won"),
    ],
)
def test_a_training_gone_astray_is_told_early(kernel: Any, margin: float, reason: str) -> None:
    picker = CropPicker.of_image(np.random.default_rng(0).uniform(size=(80, 80)), 2.0, 13)
    training = KernelGanTraining(picker, is_gaussian=False, zoom=2.0, seed=0)
    training.generator = SimpleNamespace(kernel=lambda: torch.from_numpy(kernel), parameters=[])
    training._margin, training._steps = margin, 300
    with pytest.raises(KernelGanError) as failed:
        training.check()
    assert failed.value.reason == reason
