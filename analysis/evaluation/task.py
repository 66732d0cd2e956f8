"""What a detector is evaluated on: poses, noise, contrasts, and how many pairs."""

import json
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import product
from math import ceil, floor

import numpy as np

from analysis.evaluation.painted_changes import PaintedChange, Patch, Spot
from simulation import Model, Psf
from simulation.choices import DEFAULT_MODEL, POSE_MODELS

_VERSION = 1
"""Of the pairs; scores of others are measured again."""

_LEAST_FOLLOWUP_PX = 16
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
        """The condition in words."""
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
        Tilts of the follow-up about the middle of a crop; other than 0 they need
        ``focal_length_px`` and one of ``simulation.choices.POSE_MODELS``.
    noises_dn
        Standard deviations of white noise, added to each channel of both photographs.
    contrasts_dn
        Peaks of a spot in DN; of a patch, how much of what it changes.
    change
        What changes.
    model
        Capture model.
    reference_zoom
        Ratio of the reference's distance to the photographs'; 1 takes the photographs as
        references, with the noise that is in them.
    crop_px
        Side of the reference of a pair.
    crops
        Pairs without and pairs with a change that are cut from each photograph, for each
        condition.
    focal_length_px
        Of the camera, for tilts.
    focus_scatter_px2
        Standard deviation of what the focus of either photograph adds to the PSF's variance.
    light_scatter
        Standard deviation of the follow-up's exposure, relative, the same for all channels.
    seed
        Of all that is random.

    Raises
    ------
    ValueError
        If a value is out of range, a tilt has no focal length or no model, or a follow-up would
        be smaller than 16 px.

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
        if not self.zooms or self.zooms[0] < 1 or np.any(np.diff(self.zooms) <= 0):
            raise ValueError(f"zooms must rise from 1 or more, got {self.zooms}")
        for name in ("tilts_deg", "noises_dn", "contrasts_dn"):
            values = getattr(self, name)
            if not values or not np.all(np.isfinite(values)) or len(set(values)) < len(values):
                raise ValueError(f"{name} must be different numbers, got {values}")
        for name in ("focus_scatter_px2", "light_scatter"):
            if not (getattr(self, name) >= 0 and np.isfinite(getattr(self, name))):
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if min(self.noises_dn) < 0:
            raise ValueError(f"a noise must not be negative, got {min(self.noises_dn):g}")
        if self.crops < 1 or not self.reference_zoom >= 1:
            raise ValueError("crops and reference_zoom must be at least 1")
        self._check_tilts()
        if self.followup_px(self.zooms[-1]) < _LEAST_FOLLOWUP_PX:
            raise ValueError(
                f"at zoom {self.zooms[-1]:g} a crop of {self.crop_px} px leaves a follow-up of "
                f"{self.followup_px(self.zooms[-1])} px; at least {_LEAST_FOLLOWUP_PX} are needed"
            )
        if 2 * self.change.reach_px > self.reference_zoom * self.crop_px:
            raise ValueError(f"the change does not fit into a crop of {self.crop_px} px")

    def _check_tilts(self) -> None:
        tilted = [tilt for tilt in self.tilts_deg if tilt != 0]
        if not tilted:
            return
        if max(map(abs, tilted)) > 60:
            raise ValueError(f"tilts up to 60 degrees, got {max(map(abs, tilted)):g}")
        if self.focal_length_px is None or not self.focal_length_px > 0:
            raise ValueError("a tilt needs the camera's focal length in px")
        if self.model not in POSE_MODELS:
            raise ValueError(f"a tilt needs model {' or '.join(POSE_MODELS)}, got {self.model}")

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """Every combination, the contrasts of one pose and noise together."""
        return tuple(
            Condition(zoom=zoom, tilt_deg=tilt, noise_dn=noise, contrast_dn=contrast)
            for tilt, zoom, noise, contrast in product(
                self.tilts_deg, self.zooms, self.noises_dn, self.contrasts_dn
            )
        )

    def followup_px(self, zoom: float) -> int:
        """Side of a follow-up."""
        return floor(self.crop_px / zoom + 1e-9)

    def scene_px(self, sigma_px: float) -> int:
        """Side of the part of a photograph that a pair needs, the reach of all kernels included."""
        widest = self.reference_zoom * self.zooms[-1]
        leaning = float(1 / np.cos(np.radians(max(map(abs, self.tilts_deg)))) ** 2)
        margin = ceil(_MARGIN_SIGMAS * sigma_px * widest + _TAPS_PX * widest)
        side = ceil(self.reference_zoom * self.crop_px * leaning) + 2 * margin
        # A photograph that is the reference itself is cut at whole pixels.
        return side + (side - self.crop_px) % 2

    def key(self, psf: Psf | None, detector: str, reading: str) -> str:
        """Text that differs where pairs or scores would."""
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
