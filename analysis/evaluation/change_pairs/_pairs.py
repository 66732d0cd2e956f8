"""Pairs under random conditions, with a mask of what changed; a file for each photograph."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Annotated, Self
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Field, model_validator

from acquisition.photographs import luma_plane
from acquisition.printable import on_one_line
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from analysis.choices import ChangeSigns
from analysis.errors import RefusedPhotographError, ResultsFileError
from analysis.evaluation.pairs import PairMaker
from analysis.evaluation.task import Condition, EvaluationTask, Spot
from simulation import Model, Psf
from simulation.arguments import CheckedModel
from simulation.arrays import BoolArray, Float32Array, FloatArray
from simulation.choices import DEFAULT_MODEL


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledPair:
    """A reference and a follow-up, and what changed between them.

    Parameters
    ----------
    reference, followup
        Shape ``(rows, cols)`` each, or ``(rows, cols, 3)`` of a photograph in colour; levels in DN,
        linear in light.
    homography
        Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.
    is_changed
        Whether there is a change.
    mask
        The follow-up's pixels that show more than half of the change's peak, ``(rows, cols)``.
    condition
        Pose, noise and contrast; the contrast also of a pair without a change.
    sigma_px
        Width of the change in px of the photograph.
    """

    reference: Float32Array = field(repr=False)
    followup: Float32Array = field(repr=False)
    homography: NDArray[np.float64] = field(repr=False)
    is_changed: bool
    mask: BoolArray = field(repr=False)
    condition: Condition
    sigma_px: float


def pairs_bytes(pairs: Sequence[LabelledPair]) -> bytes:
    """Return the content of a file of pairs, an ``.npz``.

    It has ``reference`` (pairs, rows, cols), or (pairs, rows, cols, 3) in colour, ``homography``
    (pairs, 3, 3), ``is_changed`` (pairs,), for each pair ``followup_K`` and ``mask_K``, whose
    shapes differ, and ``conditions``, the bytes of a JSON list.
    """
    told = [{**asdict(pair.condition), "sigma_px": pair.sigma_px} for pair in pairs]
    arrays: dict[str, NDArray[np.generic]] = {
        "reference": np.stack([pair.reference for pair in pairs]),
        "homography": np.stack([pair.homography for pair in pairs]),
        "is_changed": np.array([pair.is_changed for pair in pairs]),
        "conditions": np.frombuffer(json.dumps(told).encode(), np.uint8),
    }
    for number, pair in enumerate(pairs):
        arrays[f"followup_{number}"] = pair.followup
        arrays[f"mask_{number}"] = pair.mask
    file = BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def read_pairs(path: Path) -> list[LabelledPair]:
    """Read a file of pairs.

    Raises
    ------
    ResultsFileError
        If it cannot be read, or is none.
    """
    try:
        content = BytesIO(read_regular_file(path, LARGEST_IMAGE_BYTES))
        with np.load(content, allow_pickle=False) as stored:
            references, homographies = stored["reference"], stored["homography"]
            told = json.loads(stored["conditions"].tobytes())
            return [
                LabelledPair(
                    reference=references[number],
                    followup=_image(stored[f"followup_{number}"]),
                    homography=np.asarray(homographies[number], np.float64),
                    is_changed=bool(is_changed),
                    mask=np.asarray(stored[f"mask_{number}"], np.bool_),
                    sigma_px=float(told[number].pop("sigma_px")),
                    condition=Condition(**told[number]),
                )
                for number, is_changed in enumerate(stored["is_changed"])
            ]
    except OSError as error:
        why = error.strerror or str(error)
        raise ResultsFileError(f"cannot read {on_one_line(path)}: {why}") from error
    except (ValueError, KeyError, TypeError, IndexError, EOFError, BadZipFile) as error:
        raise ResultsFileError(
            f"{on_one_line(path)} is damaged, or is not a file of pairs; run the command "
            "that made it"
        ) from error


def _image(levels: FloatArray) -> Float32Array:
    if levels.ndim not in (2, 3) or levels.shape[2:] not in ((), (3,)):
        raise ValueError("no image")
    if levels.dtype != np.float32:
        raise ValueError("no image")
    return np.asarray(levels, np.float32)


_CONDITIONS_STREAM = 1 << 31
"""Keeps the draws of the conditions apart from those of the pairs, whose numbers are small."""

_PEAK_SHARE = 0.5
_HIDDEN = 0.02
"""Share of a change's peak of which nobody would say that it is seen."""


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] <= ends[1]:
        raise ValueError(f"the ends of a range must rise, got {ends[0]:g} and {ends[1]:g}")
    return ends


Range = Annotated[tuple[float, float], AfterValidator(_rising)]
"""Least and largest value."""


class ChangePairsTask(CheckedModel):
    """Conditions of the pairs of a data set; each pair draws its own from these ranges.

    A range is its lowest and highest value. Zoom, noise, contrast and width are drawn evenly on a
    logarithmic scale, the tilt on a linear one.

    Parameters
    ----------
    zooms
        Range of the follow-up's distance over the reference's, from 1.
    tilts_deg
        Range of the follow-up's tilt, from 0; a tilt above 0 needs ``focal_length_px`` and the
        model ``matched`` or ``lmmse``.
    noises_dn
        Range of the standard deviation of the white noise of both photographs, in each colour
        channel; a range that begins at 0 is drawn on a linear scale.
    contrasts_dn
        Range of the absolute peak of the change, a Gaussian spot, in DN.
    changes
        Whether spots are brighter than the scene, darker, or either.
    sigmas_px
        Range of the width (sigma) of the spot, in px of the photograph.
    model, reference_zoom, crop_px, focal_length_px, focus_scatter_px2, light_scatter
        As in `EvaluationTask`.
    pairs
        Number of pairs without a change, and of as many with one, that are cut from each
        photograph.
    test_fraction
        Share of the photographs that is kept for testing.
    seed
        Seed of all random numbers.

    Raises
    ------
    ValueError
        If a value is out of range, or no pair can be made at an end of the ranges.

    Examples
    --------
    >>> task = standoff.ChangePairsTask(zooms=(1, 2), noises_dn=(1, 3))
    >>> task.zooms, task.pairs
    ((1.0, 2.0), 20)
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    zooms: Range = (1.0, 2.5)
    tilts_deg: Range = (0.0, 0.0)
    noises_dn: Range = (1.0, 4.0)
    contrasts_dn: Range = (6.0, 40.0)
    changes: ChangeSigns = "both"
    sigmas_px: Range = (1.5, 3.0)
    model: Model = DEFAULT_MODEL
    reference_zoom: float = 1.0
    crop_px: int = 96
    pairs: int = Field(default=20, ge=1)
    focal_length_px: float | None = None
    focus_scatter_px2: float = 0.0
    light_scatter: float = 0.0
    test_fraction: float = Field(default=0.2, ge=0, le=1)
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, least in (("zooms", 1), ("tilts_deg", 0), ("noises_dn", 0)):
            if getattr(self, name)[0] < least:
                raise ValueError(f"{name} must start at {least} or more")
        if not (self.contrasts_dn[0] > 0 and self.sigmas_px[0] > 0):
            raise ValueError("contrasts_dn and sigmas_px must be positive")
        self.widest  # noqa: B018  its construction checks the ends of the ranges together
        return self

    @property
    def widest(self) -> EvaluationTask:
        """The task, of all that can be drawn, that needs the largest part of a photograph."""
        return self._task(
            Condition(
                zoom=self.zooms[1],
                tilt_deg=self.tilts_deg[1],
                noise_dn=self.noises_dn[1],
                contrast_dn=self.contrasts_dn[1],
            ),
            self.sigmas_px[1],
        )

    def drawn(self, rng: np.random.Generator) -> EvaluationTask:
        """Return a task of one condition, drawn from the ranges."""
        zoom, contrast, sigma = (
            _logarithmic(ends, rng) for ends in (self.zooms, self.contrasts_dn, self.sigmas_px)
        )
        tilt = float(rng.uniform(*self.tilts_deg))
        noise = (
            _logarithmic(self.noises_dn, rng)
            if self.noises_dn[0] > 0
            else float(rng.uniform(*self.noises_dn))
        )
        is_brighter = {"brighter": True, "darker": False}.get(self.changes, rng.random() < 0.5)
        condition = Condition(
            zoom=zoom,
            tilt_deg=tilt,
            noise_dn=noise,
            contrast_dn=contrast if is_brighter else -contrast,
        )
        return self._task(condition, sigma)

    def _task(self, condition: Condition, sigma_px: float) -> EvaluationTask:
        return EvaluationTask(
            zooms=(condition.zoom,),
            tilts_deg=(condition.tilt_deg,),
            noises_dn=(condition.noise_dn,),
            contrasts_dn=(condition.contrast_dn,),
            change=Spot(sigma_px=sigma_px),
            model=self.model,
            reference_zoom=self.reference_zoom,
            crop_px=self.crop_px,
            crops=self.pairs,
            focal_length_px=self.focal_length_px,
            focus_scatter_px2=self.focus_scatter_px2,
            light_scatter=self.light_scatter,
            seed=self.seed,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Photograph:
    """What all pairs of a photograph share."""

    levels_dn: FloatArray
    digest: str
    psf: Psf | None
    depth: FloatArray | None

    def maker(self, task: EvaluationTask) -> PairMaker:
        return PairMaker(
            levels_dn=self.levels_dn,
            digest=self.digest,
            task=task,
            psf=self.psf,
            depth=self.depth,
        )


def labelled_pairs(
    levels_dn: FloatArray,
    digest: str,
    task: ChangePairsTask,
    psf: Psf | None,
    depth: FloatArray | None = None,
) -> Iterator[LabelledPair]:
    """Yield the pairs of a photograph, of each crop the one without and then the one with a change.

    The same photograph gives the same bits wherever they are made.

    Parameters
    ----------
    levels_dn
        Shape ``(rows, cols)``, or ``(rows, cols, 3)`` for pairs in colour, linear in light.
    digest
        Hash of the photograph's content, in hexadecimal digits.
    task, psf
        What pairs, and the camera's total PSF.
    depth
        Of what the photograph shows, as for `PairMaker`; a hidden change is labelled as none.

    Raises
    ------
    RefusedPhotographError
        If the photograph is too small for the widest pair, or its depth does not fit.
    """
    photograph = _Photograph(levels_dn=levels_dn, digest=digest, psf=psf, depth=depth)
    photograph.maker(task.widest)  # refuses a small photograph as a whole
    content = int(digest[:16] or "0", 16)
    for crop in range(task.pairs):
        rng = np.random.default_rng([task.seed, content, crop, _CONDITIONS_STREAM])
        drawn = task.drawn(rng)
        changed = _changed_pixels(photograph, drawn, crop)
        (condition,) = drawn.conditions
        for pair in photograph.maker(drawn).pairs(crop, condition):
            is_changed = pair.place is not None and bool(changed.any())
            yield LabelledPair(
                reference=pair.reference,
                followup=pair.followup,
                homography=pair.homography,
                is_changed=is_changed,
                mask=changed if is_changed else np.zeros_like(changed),
                condition=condition,
                sigma_px=drawn.change.sigma_px or 0.0,
            )


def _changed_pixels(photograph: _Photograph, task: EvaluationTask, crop: int) -> BoolArray:
    """Where the follow-up shows more than half of the change's peak: from a pair without noise."""
    clean = replace(task, noises_dn=(0.0,), focus_scatter_px2=0.0, light_scatter=0.0)
    (condition,) = clean.conditions
    before, after = (
        pair.followup.astype(np.float64) for pair in photograph.maker(clean).pairs(crop, condition)
    )
    added = np.sign(condition.contrast_dn) * luma_plane(after - before)
    if photograph.depth is not None and added.max() <= _HIDDEN * abs(condition.contrast_dn):
        return np.zeros(added.shape, dtype=np.bool_)
    if not added.max() > 0:
        raise RefusedPhotographError("its levels are so large that a change is lost in rounding")
    return np.asarray(added > _PEAK_SHARE * added.max())


def _logarithmic(ends: tuple[float, float], rng: np.random.Generator) -> float:
    """A value from between the ends, which are positive."""
    value = float(np.exp(rng.uniform(*np.log(ends))))
    return min(max(value, ends[0]), ends[1])
