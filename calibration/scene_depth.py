"""Depth of a photograph's scene, read from a map or from a list of planes."""

from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import Field, model_validator
from skimage.draw import polygon

from acquisition.files import StoredModel
from acquisition.photographs import LARGEST_IMAGE_PX, read_file
from calibration.documents import read_document
from calibration.errors import DepthFileError
from simulation import SceneDepth
from simulation.arguments import ArgumentError
from simulation.arrays import FloatArray

_Depth = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Count = Annotated[int, Field(strict=True, gt=1)]
_Point = tuple[
    Annotated[float, Field(allow_inf_nan=False)], Annotated[float, Field(allow_inf_nan=False)]
]

_ON_PLANE = 1e-3
"""Relative distance of a corner from the plane of all."""


class DepthPlane(StoredModel):
    """A flat thing, by its outline in px ``(x, y)`` and its depth, one or one for each corner."""

    outline_px: Annotated[tuple[_Point, ...], Field(min_length=3)]
    depth: _Depth | tuple[_Depth, ...]

    @model_validator(mode="after")
    def _check_depths(self) -> "DepthPlane":
        if isinstance(self.depth, tuple):
            if len(self.depth) != len(self.outline_px):
                raise ValueError(
                    f"{len(self.outline_px)} corners need one depth, or as many, "
                    f"not {len(self.depth)}"
                )
            inverse = 1 / np.array(self.depth)
            if np.abs(self._corners @ self.inverse - inverse).max() > _ON_PLANE * inverse.max():
                raise ValueError("the corners do not lie on a plane")
        return self

    @property
    def _corners(self) -> FloatArray:
        return np.column_stack([np.array(self.outline_px), np.ones(len(self.outline_px))])

    @property
    def inverse(self) -> FloatArray:
        """Inverse depth of its plane, shape (3,): at ``(x, y)``, the product with ``(x, y, 1)``."""
        if not isinstance(self.depth, tuple):
            return np.array([0.0, 0.0, 1 / self.depth])
        found = np.linalg.lstsq(self._corners, 1 / np.array(self.depth), rcond=None)[0]
        return np.asarray(found, dtype=np.float64)


class DepthPlanes(StoredModel):
    """A scene of flat things before a background that is parallel to the sensor."""

    schema_name: Literal["standoff.depth-planes/1"] = Field(
        default="standoff.depth-planes/1", alias="schema"
    )
    size: tuple[_Count, _Count]
    depth: _Depth
    planes: tuple[DepthPlane, ...] = ()

    def depth_map(self) -> FloatArray:
        """Depth of each pixel's centre, shape ``(rows, cols)``: that of the nearest thing there."""
        width, height = self.size
        inverse = np.full((height, width), 1 / self.depth)
        for plane in self.planes:
            x, y = np.array(plane.outline_px).T
            rows, cols = polygon(y, x, (height, width))  # type: ignore[no-untyped-call]
            a, b, c = plane.inverse
            inverse[rows, cols] = np.maximum(inverse[rows, cols], a * cols + b * rows + c)
        return 1 / inverse


def depth_of_file(path: Path) -> FloatArray:
    """Read a depth map, TIFF or PNG, or a list of planes, JSON; NaN where it is not known.

    A map has one channel; 0 and what is not finite are unknown.
    """
    if path.suffix.lower() == ".json":
        planes = read_document(path, DepthPlanes, DepthFileError, "give a list of planes")
        if planes.size[0] * planes.size[1] > LARGEST_IMAGE_PX:
            raise DepthFileError(
                f"{path}: size: at most {LARGEST_IMAGE_PX / 1e6:g} million pixels", key="size"
            )
        return planes.depth_map()
    data = np.frombuffer(read_file(path), np.uint8)
    try:
        found = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    except cv2.error:
        found = None
    if found is None:
        raise DepthFileError(
            f"{path}: no depth map; give a TIFF or PNG of one channel, or a list of planes as JSON",
            source=str(path),
        )
    if found.ndim != 2:
        raise DepthFileError(
            f"{path}: a depth map has one channel, this image {found.shape[2]}", source=str(path)
        )
    depth = np.asarray(found, dtype=np.float64)
    return np.where(np.isfinite(depth) & (depth != 0), depth, np.nan)


def scene_depth(path: Path, focal_length_px: float | None, plane_depth: float | None) -> SceneDepth:
    """Read the depth of a scene, as its camera and a homography's plane need it."""
    try:
        return SceneDepth(
            depth=depth_of_file(path), focal_length_px=focal_length_px, plane_depth=plane_depth
        )
    except ArgumentError as error:
        if error.argument != "depth":
            raise
        raise DepthFileError(f"{path}: {error.reason}", source=str(path)) from error
