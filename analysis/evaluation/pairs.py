"""Pairs of photographs with and without a change, made from one photograph by the capture model."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from analysis.errors import RefusedPhotographError
from analysis.evaluation.roc import Disc
from analysis.evaluation.task import Condition, EvaluationTask, LaterScene
from analysis.pose import ViewingCamera
from simulation import (
    PoseOptions,
    Psf,
    SamplingGrid,
    SceneDepth,
    simulate_pose_of_image,
    zoom_out_on_grid,
)
from simulation.arrays import BoolArray, Float32Array, FloatArray
from simulation.choices import POSE_MODELS
from simulation.pose import DepthRendering, DepthView

_AWAY = 0.25
"""Of the crop, how far from its border a change lies at the least."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangePair:
    """A reference and a follow-up, as a detector gets them.

    Parameters
    ----------
    reference, followup
        Levels in DN, linear in light, shape ``(rows, cols)`` or, in colour, ``(rows, cols, 3)``.
    homography
        From follow-up to reference pixels, shape (3, 3).
    place
        Where the follow-up shows the change; None of a pair without one.
    crop
        Which of the photograph's crops it was cut from.
    condition
        Pose, noise and contrast.
    """

    reference: Float32Array
    followup: Float32Array
    homography: FloatArray
    place: Disc | None
    crop: int
    condition: Condition

    @property
    def name(self) -> str:
        """The pair in words."""
        kind = "without a change" if self.place is None else "with a change"
        return f"pair {self.crop + 1} {kind}, {self.condition.name}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairMaker:
    """Makes the pairs of one photograph.

    Every pair has noise, focus and light of its own, drawn from ``seed``, the photograph's content
    and the pair's number: the same pair is the same bits wherever it is made.

    Parameters
    ----------
    levels_dn
        The photograph, linear in light: shape ``(rows, cols)``, or ``(rows, cols, 3)`` for pairs in
        colour, each channel of which has noise of its own.
    digest
        Hash of its content, in hexadecimal digits.
    task, psf
        What pairs are asked for, and the camera's total PSF.
    later
        The scene as it was later, instead of the task's change; in colour as the photograph is.
    depth
        Depth of what the photograph shows, as `SceneDepth` has it; by default the scene is flat.
        Homographies are then those of the plane that is parallel to the sensor at the depth of a
        crop's middle. What a follow-up sees that the photograph does not show is filled from
        around it, the same in both follow-ups; a change may be hidden.

    Raises
    ------
    RefusedPhotographError
        If the photograph is too small, the later one or the depth map has another size, the change
        does not fit into a crop, or the task cannot be done with depth.
    """

    levels_dn: FloatArray
    digest: str
    task: EvaluationTask
    psf: Psf | None
    later: LaterScene | None = None
    depth: FloatArray | None = None

    def __post_init__(self) -> None:
        side, least = min(self.levels_dn.shape[:2]), self._side_px
        if side < least:
            raise RefusedPhotographError(
                f"it has {self.levels_dn.shape[1]} x {self.levels_dn.shape[0]} px; pairs of "
                f"{self.task.crop_px} px at zoom {self.task.zooms[-1]:g} need {least} px a side"
            )
        if self.depth is not None:
            self._check_depth(self.depth)
        if self.later is None:
            return
        if self.later.after_dn.shape != self.levels_dn.shape:
            raise RefusedPhotographError("the later photograph has a different size")
        if 2 * self.later.radius_px > self.task.reference_zoom * self.task.crop_px:
            raise RefusedPhotographError(
                f"what changed is {2 * self.later.radius_px:.0f} px wide and does not fit into a "
                f"crop of {self.task.crop_px} px"
            )

    def _check_depth(self, depth: FloatArray) -> None:
        if depth.shape != self.levels_dn.shape[:2]:
            raise RefusedPhotographError("the depth map has a different size")
        if self.task.reference_zoom != 1 or self.task.model not in POSE_MODELS:
            raise RefusedPhotographError(
                "a scene with depth needs reference zoom 1, and model " + " or ".join(POSE_MODELS)
            )

    def pairs(self, crop: int, condition: Condition) -> Iterator[ChangePair]:
        """Yield the pair without a change and the pair with one, of one crop and condition."""
        scene, changed, (top, left), centre = self._scenes(crop, condition.contrast_dn)
        view = _view(self.task, condition.zoom, condition.tilt_deg, self._turn(crop))
        seen = self._seen(view, condition, (top, left))
        number = self.task.conditions.index(condition)
        for is_changed, shown in ((False, scene), (True, changed)):
            rng = self._rng(crop, 1 + number, int(is_changed))
            reference = self._blurred(self._reference(scene), rng)
            followup = self._blurred(seen.photograph(shown), rng)
            if self.task.light_scatter:
                followup = followup * max(1 + self.task.light_scatter * rng.standard_normal(), 0.1)
            reference = reference + rng.normal(0.0, condition.noise_dn, reference.shape)
            followup = followup + rng.normal(0.0, condition.noise_dn, followup.shape)
            yield ChangePair(
                reference=reference.astype(np.float32),
                followup=followup.astype(np.float32),
                homography=view,
                place=self._place(view, seen.place(centre)) if is_changed else None,
                crop=crop,
                condition=condition,
            )

    @property
    def is_colour(self) -> bool:
        """Whether the pairs are in colour."""
        return self.levels_dn.ndim == 3

    @property
    def _side_px(self) -> int:
        gaussian = None if self.psf is None else self.psf.gaussian
        sigma = 0.0 if gaussian is None else max(gaussian.sigma_x_px, gaussian.sigma_y_px)
        return self.task.scene_px(sigma)

    @property
    def _radius_px(self) -> float:
        return (self.later or self.task.change).radius_px

    def _rng(self, *number: int) -> np.random.Generator:
        content = int(self.digest[:16] or "0", 16)
        return np.random.default_rng([self.task.seed, content, *number])

    def _turn(self, crop: int) -> float:
        """Direction towards which the camera of a crop leans, in degrees."""
        return float(self._rng(crop, 0, 1).uniform(0.0, 360.0))

    def _scenes(
        self, crop: int, contrast_dn: float
    ) -> tuple[FloatArray, FloatArray, tuple[int, int], tuple[float, float]]:
        """Part of the photograph, without and with the change: images, corner, and centre.

        The corner is ``(row, col)`` of the photograph, the change's centre ``(x, y)`` of the part.
        """
        rng, side = self._rng(crop, 0, 0), self._side_px
        if self.later is not None:
            return self._later_scenes(self.later, rng, contrast_dn)
        top, left = (int(rng.integers(0, size - side + 1)) for size in self.levels_dn.shape[:2])
        part = np.asarray(self.levels_dn[top : top + side, left : left + side], np.float64)
        reach = self.task.reference_zoom * self.task.crop_px / 2
        free = max(min((1 - 2 * _AWAY) * reach, reach - self.task.change.reach_px), 0.0)
        # Seen at a tilt, the corners of a crop are lost.
        x, y = ((side - 1) / 2 + rng.uniform(-free, free, 2)).tolist()
        return part, self.task.change.painted(part, (x, y), contrast_dn), (top, left), (x, y)

    def _later_scenes(
        self, later: LaterScene, rng: np.random.Generator, contrast: float
    ) -> tuple[FloatArray, FloatArray, tuple[int, int], tuple[float, float]]:
        """The part around what changed, by chance nearer to one side or the other."""
        side, (x, y) = self._side_px, later.middle_px
        free = max(self.task.reference_zoom * self.task.crop_px / 2 - later.radius_px, 0.0)
        corner = []
        for middle, size in ((y, self.levels_dn.shape[0]), (x, self.levels_dn.shape[1])):
            wanted = middle - (side - 1) / 2 + rng.uniform(-free, free)
            corner.append(min(max(round(wanted), 0), size - side))
        top, left = corner
        window = np.s_[top : top + side, left : left + side]
        part = np.asarray(self.levels_dn[window], np.float64)
        mask = later.mask[window] if part.ndim == 2 else later.mask[window][:, :, np.newaxis]
        added = np.where(mask, later.after_dn[window] - part, 0.0)
        return part, part + contrast * added, (top, left), (x - left, y - top)

    def _grid(self, zoom: float, side_px: int) -> SamplingGrid:
        """Pixels of a view straight onto the middle of the scene."""
        step = self.task.reference_zoom * zoom
        origin = (self._side_px - 1) / 2 - (side_px - 1) / 2 * step
        return SamplingGrid(
            zoom_y=step,
            zoom_x=step,
            origin_y_px=origin,
            origin_x_px=origin,
            rows=side_px,
            cols=side_px,
        )

    def _reference(self, scene: FloatArray) -> FloatArray:
        if self.task.reference_zoom == 1:
            first = (self._side_px - self.task.crop_px) // 2
            return scene[first : first + self.task.crop_px, first : first + self.task.crop_px]
        grid = self._grid(1.0, self.task.crop_px)
        return np.asarray(zoom_out_on_grid(scene, grid, self.psf, self.task.model), np.float64)

    def _seen(self, view: FloatArray, condition: Condition, corner: tuple[int, int]) -> "_Seen":
        """How a follow-up shows a part of the photograph whose corner is ``(row, col)``."""
        side, to_scene = self.task.followup_px(condition.zoom), self._to_scene(view)
        model, psf = self.task.model, self.psf
        if self.depth is not None:
            return self._seen_with_depth(self.depth, to_scene, side, corner)
        if condition.tilt_deg == 0:
            grid = self._grid(condition.zoom, side)
            return _Seen(lambda scene: zoom_out_on_grid(scene, grid, psf, model), to_scene)
        assert model in POSE_MODELS  # the task saw to it
        options = PoseOptions(model=model)
        return _Seen(
            lambda scene: simulate_pose_of_image(scene, to_scene, (side, side), psf, options).image,
            to_scene,
        )

    def _seen_with_depth(
        self, depth: FloatArray, to_scene: FloatArray, side: int, corner: tuple[int, int]
    ) -> "_Seen":
        part_px, (top, left) = self._side_px, corner
        part = depth[top : top + part_px, left : left + part_px]
        known = part[np.isfinite(part)]
        middle = part[part_px // 2, part_px // 2]
        if not known.size:
            raise RefusedPhotographError("the depth of one of its crops is not known")
        scene = SceneDepth(
            depth=part,
            # Of a camera that moves straight back it makes no difference.
            focal_length_px=self.task.focal_length_px or float(part_px),
            plane_depth=float(middle if np.isfinite(middle) else np.median(known)),
        )
        assert self.psf is not None
        assert self.task.model in POSE_MODELS
        view = DepthView.of_homography(scene, to_scene, (side, side))
        rendering = DepthRendering.of(scene, view, self.psf)
        options = PoseOptions(model=self.task.model)
        unseen = rendering.seen.hidden | rendering.seen.outside
        return _Seen(
            lambda image: filled(rendering.photograph(image, options).image, unseen),
            to_scene,
            rendering.seen.places_px,
        )

    def _to_scene(self, view: FloatArray) -> FloatArray:
        """From the follow-up to the part of the photograph."""
        return self._grid(1.0, self.task.crop_px).matrix @ view

    def _blurred(self, image: FloatArray, rng: np.random.Generator) -> FloatArray:
        scatter = self.task.focus_scatter_px2
        return image if scatter == 0 else refocused(image, scatter * rng.standard_normal())

    def _place(self, view: FloatArray, at: tuple[float, float]) -> Disc:
        """The change, whose centre the follow-up shows at ``(x, y)``."""
        to_scene, (x, y) = self._to_scene(view), at
        # Scale of the follow-up there, by the root of the map's change of area.
        scale = np.sqrt(abs(np.linalg.det(to_scene)) / (to_scene[2] @ (x, y, 1.0)) ** 3)
        return Disc(x_px=x, y_px=y, radius_px=float(self._radius_px / scale) + 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """How a follow-up shows a part of the photograph.

    ``rendered`` makes it of an image; ``to_scene`` is the homography from it to the part, of a
    scene with depth that of its plane, for which ``places_px`` says where every pixel looks.
    """

    rendered: Callable[[FloatArray], NDArray[np.floating[Any]]]
    to_scene: FloatArray
    places_px: FloatArray | None = None

    def photograph(self, scene: FloatArray) -> FloatArray:
        """The follow-up of the part as it is now."""
        return np.asarray(self.rendered(scene), np.float64)

    def place(self, centre: tuple[float, float]) -> tuple[float, float]:
        """Where a point ``(x, y)`` of the part is shown; if it is hidden, where the plane is."""
        if self.places_px is not None:
            y, x = self.places_px
            away = np.hypot(x - centre[0], y - centre[1])
            away[np.isnan(away)] = np.inf
            row, col = np.unravel_index(np.argmin(away), away.shape)
            if away[row, col] <= abs(np.linalg.det(self.to_scene)) ** 0.5:
                return float(col), float(row)
        x, y, w = np.linalg.solve(self.to_scene, np.array([*centre, 1.0])).tolist()
        return x / w, y / w


_FILLED_FROM_PX = 3


def filled(image: NDArray[np.floating[Any]], unseen: BoolArray) -> FloatArray:
    """An image whose unseen pixels are filled from around them; grey or in colour."""
    if not unseen.any():
        return np.asarray(image, np.float64)
    planes = image if image.ndim == 3 else image[:, :, None]
    mask = unseen.astype(np.uint8)
    made = [
        cv2.inpaint(
            np.ascontiguousarray(planes[:, :, k], np.float32), mask, _FILLED_FROM_PX, cv2.INPAINT_NS
        )
        for k in range(planes.shape[2])
    ]
    whole = np.where(unseen[:, :, None], np.stack(made, axis=-1), planes)
    return np.asarray(whole.reshape(image.shape), np.float64)


def refocused(image: FloatArray, added_px2: float) -> FloatArray:
    """Return an image whose PSF has this much more variance, or less, as another focus gives it.

    The image is grey or in colour.

    The spectrum is multiplied by ``exp(-2 pi^2 v f^2)``, mirrored at the borders.
    """
    spectrum = dctn(image, axes=(0, 1), norm="ortho")
    fy, fx = (np.arange(size) / (2 * size) for size in image.shape[:2])
    gain = np.exp(-2 * np.pi**2 * added_px2 * (fy[:, None] ** 2 + fx**2))
    if image.ndim == 3:
        gain = gain[:, :, np.newaxis]
    return np.asarray(idctn(gain * spectrum, axes=(0, 1), norm="ortho"), np.float64)


@lru_cache(maxsize=256)
def _view(task: EvaluationTask, zoom: float, tilt_deg: float, turn_deg: float) -> FloatArray:
    """Homography from follow-up to reference pixels; both middles see the same point."""
    side, crop = task.followup_px(zoom), task.crop_px
    if tilt_deg == 0:
        origin = (crop - 1) / 2 - (side - 1) / 2 * zoom
        return np.array([[zoom, 0.0, origin], [0.0, zoom, origin], [0.0, 0.0, 1.0]])
    assert task.focal_length_px is not None
    camera = ViewingCamera(focal_length_px=task.focal_length_px, width_px=crop, height_px=crop)
    whole = camera.followup_to_reference(zoom, tilt_deg, 0.0, turn_deg)
    first = (crop - 1) / 2 - (side - 1) / 2
    cut = np.array([[1.0, 0.0, first], [0.0, 1.0, first], [0.0, 0.0, 1.0]])
    matrix = whole @ cut
    return np.asarray(matrix / matrix[2, 2])
