"""Training of a learned detector on pairs with masks of what changed."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import cos, pi
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from analysis.detectors.learned._weights import (
    LearnedDetector,
    on_one_grid,
    one_thread,
    require_torch,
)
from simulation.arguments import ArgumentError, check_fields, checked
from simulation.arrays import BoolArray, Float32Array, FloatArray

if TYPE_CHECKING:
    from torch import Tensor

    from analysis.detectors.learned._network import SiameseNetwork

_CHANGED_WEIGHT: Final = 20.0
"""Of a changed pixel, of which there are few, relative to another in the loss."""

_ALIKE_BATCHES: Final = 8
"""Batches whose pairs are sorted by size together, so that little is cut off."""

_LARGEST_GRADIENT: Final = 1.0


class TrainingPair(Protocol):
    """A pair of photographs with the mask of what changed, as ``change_pairs`` makes them.

    ``reference`` and ``followup`` are levels linear in light, of shape ``(rows, cols)`` or ``(rows,
    cols, 3)``; ``homography``, of shape (3, 3), maps follow-up pixels ``(x, y, 1)`` to reference
    pixels; ``mask``, of shape ``(rows, cols)``, marks the follow-up pixels that changed.
    """

    @property
    def reference(self) -> Float32Array: ...
    @property
    def followup(self) -> Float32Array: ...
    @property
    def homography(self) -> FloatArray: ...
    @property
    def mask(self) -> BoolArray: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingOptions:
    """Options for the training of a detector.

    Parameters
    ----------
    epochs
        Number of times that each pair is used.
    batch
        Number of pairs per step.
    rate
        Initial learning rate of Adam; it falls to 0 along a cosine.
    seed
        Seed of the initial weights, and of the order and the crops of the pairs.

    Raises
    ------
    ArgumentError
        If a value is out of range.

    Examples
    --------
    >>> standoff.TrainingOptions(epochs=4).batch
    8
    """

    epochs: int = 8
    batch: int = 8
    rate: float = 2e-3
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.rate >= 1:
            raise ArgumentError(f"expected a number below 1, got {self.rate:g}", argument="rate")


@checked
def train_detector(
    pairs: Iterable[TrainingPair],
    options: TrainingOptions | None = None,
    progress: Callable[[int, int, float], None] = lambda *_: None,
) -> LearnedDetector:
    """Train a detector from scratch; the same pairs and options give the same detector.

    The training uses one thread, and leaves the global random state as it is.

    Parameters
    ----------
    pairs
        Pairs to train on, some with and some without a change; read once. Of colour photographs the
        luma is used.
    options
        Options for the training; the defaults of ``TrainingOptions`` if None.
    progress
        Called after each step with the number of steps done, the number of all steps, and the loss.

    Returns
    -------
    LearnedDetector
        The detector: call it, or ``save`` it to a file that ``standoff evaluate`` takes.

    Raises
    ------
    DetectorError
        If PyTorch is not installed; ``reason`` is then ``missing``.
    ValueError
        If there are no pairs, none with a change, or none without one.

    Examples
    --------
    >>> task = standoff.ChangePairsTask(zooms=(1, 1.5), crop_px=64, pairs=2, test_fraction=0)
    >>> made = standoff.change_pairs("photographs", "pairs", "psf.json", task)
    >>> few = standoff.TrainingOptions(epochs=1, batch=4)
    >>> detector = standoff.train_detector(made.dataset.pairs("train"), few)
    >>> detector.save("detector.pt")
    """
    require_torch()
    import torch

    from analysis.detectors.learned._network import SiameseNetwork

    options = options or TrainingOptions()
    known = [(on_one_grid(p.reference, p.followup, p.homography), p.mask) for p in pairs]
    if len({bool(mask.any()) for _, mask in known}) < 2:
        raise ArgumentError("training needs pairs with a change and pairs without one")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(options.seed)
        network = SiameseNetwork()
    network.train()
    with one_thread():
        _descend(network, known, options, progress)
    return LearnedDetector(network)


def _descend(
    network: "SiameseNetwork",
    known: list[tuple[Float32Array, BoolArray]],
    options: TrainingOptions,
    progress: Callable[[int, int, float], None],
) -> None:
    import torch

    optimiser = torch.optim.Adam(network.parameters(), lr=options.rate)
    steps = options.epochs * -(-len(known) // options.batch)
    rng = np.random.default_rng(options.seed)
    batches = (batch for _ in range(options.epochs) for batch in _batches(known, options, rng))
    for done, (images, masks) in enumerate(batches):
        for group in optimiser.param_groups:
            group["lr"] = options.rate * (1 + cos(pi * done / steps)) / 2
        optimiser.zero_grad()
        loss = _loss(network(torch.from_numpy(images)), torch.from_numpy(masks))
        loss.backward()  # type: ignore[no-untyped-call] # torch's own
        torch.nn.utils.clip_grad_norm_(network.parameters(), _LARGEST_GRADIENT)
        optimiser.step()
        progress(done + 1, steps, float(loss.detach()))


def _loss(odds: "Tensor", masks: "Tensor") -> "Tensor":
    """Cross entropy of the pixels, and of whether there is a change, which the largest says."""
    import torch
    from torch.nn.functional import binary_cross_entropy_with_logits as cross_entropy

    weight = torch.tensor(_CHANGED_WEIGHT)
    of_pixels = cross_entropy(odds, masks, pos_weight=weight)
    of_pairs = cross_entropy(odds.amax((1, 2, 3)), masks.amax((1, 2, 3)))
    return of_pixels + of_pairs


def _batches(
    known: list[tuple[Float32Array, BoolArray]], options: TrainingOptions, rng: np.random.Generator
) -> Iterator[tuple[Float32Array, Float32Array]]:
    """Yield images ``(N, 2, H, W)`` and masks ``(N, 1, H, W)``, of each pair once, turned about."""
    order = rng.permutation(len(known))
    batches = []
    alike = _ALIKE_BATCHES * options.batch
    for first in range(0, len(order), alike):
        group = sorted(order[first : first + alike], key=lambda one: known[one][1].size)
        batches += [group[at : at + options.batch] for at in range(0, len(group), options.batch)]
    for place in rng.permutation(len(batches)):
        chosen = [known[one] for one in batches[place]]
        rows, cols = (min(mask.shape[axis] for _, mask in chosen) for axis in (0, 1))
        turned = [_cut(images, mask, min(rows, cols), rng) for images, mask in chosen]
        yield np.stack([one[:2] for one in turned]), np.stack([one[2:] for one in turned])


def _cut(
    images: Float32Array, mask: BoolArray, side_px: int, rng: np.random.Generator
) -> Float32Array:
    """A square of the photographs and the mask, turned and mirrored at random."""
    top, left = (int(rng.integers(0, size - side_px + 1)) for size in mask.shape)
    planes = np.concatenate([images, mask[np.newaxis].astype(np.float32)])
    square = planes[:, top : top + side_px, left : left + side_px]
    square = np.rot90(square, int(rng.integers(4)), axes=(1, 2))
    if rng.random() < 0.5:
        square = square[:, :, ::-1]
    return np.ascontiguousarray(square)
