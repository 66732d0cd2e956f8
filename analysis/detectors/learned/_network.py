"""A Siamese network of 62,000 weights: features of both photographs, their difference, a map."""

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

_CHANNELS: Final = (16, 24, 32)
_DECODED: Final = (16, 24, 32)
_FILTER_PX: Final = 7
"""Side of the first, linear filters: the difference of what they give is a filtered difference."""

_LIGHT_PX: Final = 9
"""Side of the window of the local mean: light varies more slowly, texture faster."""

_FLAT: Final = 1e-6
_LEAST_GAIN: Final = 0.05
_RARE: Final = -4.0
"""Log odds of a changed pixel before anything is learned."""


class SiameseNetwork(nn.Module):
    """Maps two photographs on one grid to the log odds of a change at each pixel.

    One encoder of three scales looks at either photograph; a decoder at the absolute differences of
    its features, and at the follow-up's coarsest ones, which tell how much texture there is.
    """

    def __init__(self) -> None:
        super().__init__()
        fine, middle, coarse = _CHANNELS
        self.fine = nn.Conv2d(1, fine, _FILTER_PX, padding=_FILTER_PX // 2, bias=False)
        self.middle = _halved(fine, middle)
        self.coarse = _halved(middle, coarse)
        self.from_coarse = nn.Conv2d(2 * coarse, _DECODED[2], 3, padding=1)
        self.from_middle = nn.Conv2d(_DECODED[2] + middle, _DECODED[1], 3, padding=1)
        self.from_fine = nn.Conv2d(_DECODED[1] + fine, _DECODED[0], 3, padding=1)
        self.odds = nn.Conv2d(_DECODED[0], 1, 3, padding=1)
        nn.init.constant_(self.odds.bias, _RARE)  # type: ignore[arg-type] # it has one

    def forward(self, images: Tensor) -> Tensor:
        """Return log odds, shape ``(N, 1, H, W)``.

        Parameters
        ----------
        images
            Shape ``(N, 2, H, W)``: the reference on the follow-up's grid, and the follow-up, in any
            linear unit. Height and width are any.
        """
        pairs = images.shape[0]
        seen = torch.cat(comparable(images))
        fine = self.fine(seen)
        middle = self.middle(_compressed(fine))
        coarse = self.coarse(middle)
        apart = [(one[pairs:] - one[:pairs]).abs() for one in (fine, middle, coarse)]
        known = torch.cat([apart[2], coarse[pairs:]], 1)
        known = _enlarged(functional.relu(self.from_coarse(known)), apart[1])
        known = torch.cat([known, apart[1]], 1)
        known = _enlarged(functional.relu(self.from_middle(known)), apart[0])
        known = torch.cat([known, _compressed(apart[0])], 1)
        odds: Tensor = self.odds(functional.relu(self.from_fine(known)))
        return odds


def comparable(images: Tensor) -> tuple[Tensor, Tensor]:
    """Return reference and follow-up, whatever the units and the light.

    The reference is brought to the follow-up's light by the gain and offset between the local means
    of both. The local mean is taken off, and the rest is divided by the mean absolute difference,
    which a small change hardly moves.

    Parameters
    ----------
    images
        Shape ``(N, 2, H, W)``.
    """
    reference, followup = images[:, :1], images[:, 1:]
    offset = followup.mean((1, 2, 3), keepdim=True)
    after = followup - offset
    before = reference - reference.mean((1, 2, 3), keepdim=True)
    coarse_before, coarse_after = _local_mean(before), _local_mean(after)
    power = (coarse_before**2).mean((1, 2, 3), keepdim=True)
    least = (_FLAT * offset) ** 2 + 1e-30
    gain = (coarse_before * coarse_after).mean((1, 2, 3), keepdim=True) / (power + least)
    is_light = (gain > _LEAST_GAIN) & (power > least)
    gain = torch.where(is_light, gain, torch.ones_like(gain))
    scale = (after - gain * before).abs().mean((1, 2, 3), keepdim=True)
    scale = scale + _FLAT * offset.abs() + 1e-15
    middle = gain * coarse_before
    return (gain * before - middle) / scale, (after - middle) / scale


def _halved(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, 2, padding=1),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.ReLU(),
    )


def _compressed(features: Tensor) -> Tensor:
    """Linear below 1, the noise, and logarithmic above: texture is a hundred times as strong."""
    return features.sign() * torch.log(1 + features.abs())


def _local_mean(image: Tensor) -> Tensor:
    return functional.avg_pool2d(
        image, _LIGHT_PX, stride=1, padding=_LIGHT_PX // 2, count_include_pad=False
    )


def _enlarged(image: Tensor, like: Tensor) -> Tensor:
    return functional.interpolate(image, size=like.shape[-2:], mode="nearest")
