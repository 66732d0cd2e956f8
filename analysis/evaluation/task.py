"""What a detector is evaluated on: poses, noise, changes that are put into a scene, and pairs."""

import json
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import product
from math import ceil, floor
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.photographs import luma_plane
from analysis.detectability import GaussianSignal
from simulation import Model, Psf
from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.choices import DEFAULT_MODEL, POSE_MODELS
from simulation.notebook import Shown

_LEAST_ALPHA = 0.05
"""Of a patch's pixels, those fainter than this are not seen as part of it."""


class PaintedChange(Protocol):
    """A change to paint into a scene; px are those of the photograph."""

    @property
    def name(self) -> str:
        """What kind of change it is."""
        ...

    @property
    def sigma_px(self) -> float | None:
        """Width (sigma) of a Gaussian spot; None for any other change."""
        ...

    @property
    def reach_px(self) -> float:
        """Distance from its centre beyond which it changes nothing."""
        ...

    @property
    def radius_px(self) -> float:
        """Distance from its centre within which it is visible."""
        ...

    def painted(
        self, scene_dn: FloatArray, centre_px: tuple[float, float], contrast_dn: float
    ) -> FloatArray:
        """Return the scene with the change, its centre at ``(x, y)``; the scene stays as it is.

        The scene has shape ``(rows, cols)`` or, in colour, ``(rows, cols, 3)``.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot(GaussianSignal):
    """A Gaussian spot that adds ``contrast_dn exp(-r^2 / (2 sigma^2))``, to each channel alike.

    Raises
    ------
    ArgumentError
        If the width is not positive.

    Examples
    --------
    >>> standoff.EvaluationTask(change=standoff.Spot(sigma_px=3.0)).change.sigma_px
    3.0
    """

    @property
    def name(self) -> str:
        """What kind of change it is."""
        return "spot"

    @property
    def radius_px(self) -> float:
        """Twice its width."""
        return 2 * self.sigma_px

    def painted(
        self, scene_dn: FloatArray, centre_px: tuple[float, float], contrast_dn: float
    ) -> FloatArray:
        """See `PaintedChange.painted`."""
        across, down = (
            np.exp(-0.5 * ((np.arange(size) - at) / self.sigma_px) ** 2)
            for size, at in zip(scene_dn.shape[1::-1], centre_px, strict=True)
        )
        spot = contrast_dn * np.outer(down, across)
        return np.asarray(scene_dn + (spot if scene_dn.ndim == 2 else spot[:, :, np.newaxis]))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Patch(Shown, ByValue):
    """A picture that covers the scene as far as its alpha says, at any subpixel position.

    Where alpha is 1 the scene takes the patch's levels. ``contrast_dn`` is then a factor on the
    change: 1 for the patch as it is. A grey scene takes the luma of a colour patch, and all
    channels of a colour scene take the levels of a grey patch.

    Parameters
    ----------
    levels_dn
        Shape ``(rows, cols)``, or ``(rows, cols, 3)`` in colour, linear in light.
    alpha
        Shape ``(rows, cols)``, from 0 to 1.
    name
        Name of the change in results.

    Raises
    ------
    ArgumentError
        If levels and alpha differ in shape or are not finite, or nothing is covered.
    """

    levels_dn: FloatArray
    alpha: FloatArray
    name: str = "patch"

    def __post_init__(self) -> None:
        check_fields(self)
        levels, alpha = self.levels_dn, self.alpha
        if alpha.ndim != 2 or levels.shape not in (alpha.shape, (*alpha.shape, 3)):
            raise ArgumentError("a patch needs levels and an alpha of one shape (rows, cols)")
        if not (np.all(np.isfinite(levels)) and np.all((alpha >= 0) & (alpha <= 1))):
            raise ArgumentError("a patch needs finite levels and an alpha from 0 to 1")
        if not np.any(alpha > _LEAST_ALPHA):
            raise ArgumentError("the patch is transparent everywhere")

    @property
    def sigma_px(self) -> None:
        """None: a patch has no such width."""
        return

    @property
    def reach_px(self) -> float:
        """Half of its diagonal."""
        return float(np.hypot(*self.alpha.shape) / 2 + 1)

    @property
    def radius_px(self) -> float:
        """Distance of its farthest opaque pixel from its middle."""
        y, x = np.nonzero(self.alpha > _LEAST_ALPHA)
        rows, cols = self.alpha.shape
        return float(np.hypot(y - (rows - 1) / 2, x - (cols - 1) / 2).max()) + 0.5

    def painted(
        self, scene_dn: FloatArray, centre_px: tuple[float, float], contrast_dn: float
    ) -> FloatArray:
        """See `PaintedChange.painted`."""
        rows, cols = self.alpha.shape
        left, top = centre_px[0] - (cols - 1) / 2, centre_px[1] - (rows - 1) / 2
        x, y = ceil(left) - 1, ceil(top) - 1
        shift = np.array([[1.0, 0.0, left - x], [0.0, 1.0, top - y]])
        size = cols + 2, rows + 2
        # Levels weighted with alpha: what is transparent has no levels.
        covering = self.alpha if scene_dn.ndim == 2 else np.repeat(self.alpha[..., None], 3, 2)
        alpha, weighted = (
            np.asarray(cv2.warpAffine(plane, shift, size, flags=cv2.INTER_LINEAR), np.float64)
            for plane in (covering, covering * self._levels_for(scene_dn))
        )
        out = np.array(scene_dn, dtype=np.float64)
        y0, y1 = max(y, 0), min(y + size[1], out.shape[0])
        x0, x1 = max(x, 0), min(x + size[0], out.shape[1])
        if y1 <= y0 or x1 <= x0:
            return out
        part = np.s_[y0 - y : y1 - y, x0 - x : x1 - x]
        under = out[y0:y1, x0:x1]
        out[y0:y1, x0:x1] = under + contrast_dn * (weighted[part] - alpha[part] * under)
        return out

    def _levels_for(self, scene_dn: FloatArray) -> FloatArray:
        """The levels as the scene has them, grey or for each channel."""
        if scene_dn.ndim == 2:
            return self.levels_dn if self.levels_dn.ndim == 2 else luma_plane(self.levels_dn)
        return np.atleast_3d(self.levels_dn)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LaterScene:
    """The scene as photographed later from the same pose, where a mask says that it changed.

    Parameters
    ----------
    after_dn
        Shape ``(rows, cols)``, or ``(rows, cols, 3)`` in colour; levels as in the photograph
        before.
    mask
        Where it changed, shape ``(rows, cols)``.

    Raises
    ------
    ValueError
        If the shapes differ, a level is not finite or the mask is empty.
    """

    after_dn: FloatArray
    mask: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if self.after_dn.shape not in (self.mask.shape, (*self.mask.shape, 3)):
            raise ValueError(
                f"the mask has {_size(self.mask.shape)}, the later photograph "
                f"{_size(self.after_dn.shape[:2])}"
            )
        if not np.all(np.isfinite(self.after_dn)):
            raise ValueError("the later photograph has levels that are not finite")
        if not self.mask.any():
            raise ValueError("the mask of the later photograph is empty: nothing changed")

    @property
    def in_grey(self) -> "LaterScene":
        """The same without its colours."""
        if self.after_dn.ndim == 2:
            return self
        return LaterScene(after_dn=luma_plane(self.after_dn), mask=self.mask)

    @property
    def middle_px(self) -> tuple[float, float]:
        """Middle ``(x, y)`` of what changed."""
        y, x = np.nonzero(self.mask)
        return float(x.mean()), float(y.mean())

    @property
    def radius_px(self) -> float:
        """Distance of the farthest changed pixel from the middle."""
        y, x = np.nonzero(self.mask)
        return float(np.hypot(x - x.mean(), y - y.mean()).max()) + 0.5


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(side) for side in shape[::-1]) + " px"


_VERSION = 1
"""Of the pairs; scores of others are measured again."""

_LEAST_FOLLOWUP_PX = 16
_STEEPEST_DEG = 60.0
_MARGIN_SIGMAS, _TAPS_PX = 6.0, 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """One pose, noise and contrast: a point of the curves."""

    zoom: float
    tilt_deg: float
    noise_dn: float
    contrast_dn: float

    @property
    def name(self) -> str:
        """Zoom, tilt, noise and contrast of the condition, in words."""
        return (
            f"zoom {self.zoom:g}, tilt {self.tilt_deg:g} degrees, noise {self.noise_dn:g} DN, "
            f"contrast {self.contrast_dn:g}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationTask:
    """Poses, noise, changes and pairs of an evaluation.

    Parameters
    ----------
    zooms
        Ratios of the follow-up's distance to the reference's, rising, from 1.
    tilts_deg
        Tilts of the follow-up about the middle of a crop; a tilt other than 0 needs
        ``focal_length_px`` and the model ``matched`` or ``lmmse``.
    noises_dn
        Standard deviations of white noise, added to each channel of both photographs.
    contrasts_dn
        For a spot, its peaks in DN; for a patch, factors on what it changes, 1 for the patch as it
        is.
    change
        The change that is painted into the follow-ups, such as `Spot` or `Patch`.
    model
        Capture model.
    reference_zoom
        Ratio of the reference's distance to the photographs'; with 1, the photographs are the
        references, and keep their own noise.
    crop_px
        Side of the reference of a pair, in px.
    crops
        Number of pairs without a change, and of as many with one, that are cut from each photograph
        for each condition.
    focal_length_px
        Focal length of the camera in px, for tilts.
    focus_scatter_px2
        Standard deviation of what the focus of either photograph adds to the PSF's variance.
    light_scatter
        Relative standard deviation of the follow-up's exposure, the same for all channels.
    seed
        Seed of all random numbers.

    Raises
    ------
    ArgumentError
        If a value is out of range, a tilt lacks a focal length or a model that can tilt, or a
        follow-up would be smaller than 16 px.

    Examples
    --------
    >>> task = standoff.EvaluationTask(zooms=(1.0, 1.5), noises_dn=(2.0, 4.0), contrasts_dn=(12.0,))
    >>> len(task.conditions)
    4
    """

    zooms: tuple[float, ...] = (1.0, 1.1, 1.25, 1.5, 2.0, 2.5)
    tilts_deg: tuple[float, ...] = (0.0,)
    noises_dn: tuple[float, ...] = (2.0,)
    contrasts_dn: tuple[float, ...] = (12.0,)
    change: PaintedChange = field(default_factory=Spot)
    model: Model = DEFAULT_MODEL
    reference_zoom: float = 1.0
    crop_px: int = 128
    crops: int = 20
    focal_length_px: float | None = None
    focus_scatter_px2: float = 0.0
    light_scatter: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if np.any(np.diff(self.zooms) <= 0):
            raise ArgumentError(f"expected rising numbers, got {self.zooms}", argument="zooms")
        for name in ("tilts_deg", "noises_dn", "contrasts_dn"):
            values = getattr(self, name)
            if len(set(values)) < len(values):
                raise ArgumentError(f"expected different numbers, got {values}", argument=name)
        self._check_tilts()
        if self.followup_px(self.zooms[-1]) < _LEAST_FOLLOWUP_PX:
            raise ArgumentError(
                f"at zoom {self.zooms[-1]:g} a crop of {self.crop_px} px leaves a follow-up of "
                f"{self.followup_px(self.zooms[-1])} px; at least {_LEAST_FOLLOWUP_PX} are needed"
            )
        if 2 * self.change.reach_px > self.reference_zoom * self.crop_px:
            raise ArgumentError(f"the change does not fit into a crop of {self.crop_px} px")

    def _check_tilts(self) -> None:
        steepest = max(map(abs, self.tilts_deg))
        if steepest == 0:
            return
        if steepest > _STEEPEST_DEG:
            raise ArgumentError(
                f"tilts are up to {_STEEPEST_DEG:g} degrees, got {steepest:g}", argument="tilts_deg"
            )
        if self.focal_length_px is None:
            raise ArgumentError(
                "a tilt needs the camera's focal length in px", argument="focal_length_px"
            )
        if self.model not in POSE_MODELS:
            raise ArgumentError(
                f"a tilt needs model {' or '.join(POSE_MODELS)}, got {self.model}", argument="model"
            )

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """All combinations of pose, noise and contrast; the contrasts of one pose are adjacent."""
        return tuple(
            Condition(zoom=zoom, tilt_deg=tilt, noise_dn=noise, contrast_dn=contrast)
            for tilt, zoom, noise, contrast in product(
                self.tilts_deg, self.zooms, self.noises_dn, self.contrasts_dn
            )
        )

    def followup_px(self, zoom: float) -> int:
        """Side of a follow-up in px."""
        return floor(self.crop_px / zoom + 1e-9)

    def scene_px(self, sigma_px: float) -> int:
        """Side in px of the part of a photograph that a pair needs, with the reach of kernels."""
        widest = self.reference_zoom * self.zooms[-1]
        leaning = float(1 / np.cos(np.radians(max(map(abs, self.tilts_deg)))) ** 2)
        margin = ceil(_MARGIN_SIGMAS * sigma_px * widest + _TAPS_PX * widest)
        side = ceil(self.reference_zoom * self.crop_px * leaning) + 2 * margin
        # A photograph that is the reference itself is cut at whole pixels.
        return side + (side - self.crop_px) % 2

    def key(self, psf: Psf | None, detector: str, reading: str) -> str:
        """Text that differs between tasks whose pairs or scores would differ."""
        change: object = [self.change.name, self.change.sigma_px]
        if isinstance(self.change, Patch):
            layers = np.atleast_3d(self.change.levels_dn), np.atleast_3d(self.change.alpha)
            planes = np.concatenate(layers, axis=2).transpose(2, 0, 1).astype("<f8")
            change = sha256(planes.tobytes()).hexdigest()
        stated = {
            name: getattr(self, name) for name in self.__slots__ if name not in {"change", "crops"}
        }
        return json.dumps(
            {
                **{"version": _VERSION, "change": change, "crops": self.crops},
                **{"psf": repr(psf), "detector": detector, "reading": reading},
                **stated,
            },
            sort_keys=True,
        )
