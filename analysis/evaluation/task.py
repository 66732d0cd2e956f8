"""What a detector is evaluated on: poses, noise, contrasts, and how many pairs."""

import json
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import product
from math import ceil, floor

import numpy as np

from analysis.evaluation.painted_changes import PaintedChange, Patch, Spot
from simulation import Model, Psf
from simulation.arguments import ArgumentError, check_fields
from simulation.choices import DEFAULT_MODEL, POSE_MODELS

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
    ArgumentError
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
