"""Surveys matched by the bench's own optics: captures and their points, without any picture."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from calibration.geometry import GeometryCapture, PlaneLens
from calibration.geometry._bundle_adjustment import (
    Adjustment,
    CapturePose,
    PlaneMatches,
    PosedCapture,
    Series,
    adjust,
)
from hil_mocks.truth.render import CameraPose, PinholeCamera
from tests.calibration.geometry_bench import (
    HEIGHT_PX,
    WIDTH_PX,
    exact_matches,
    pinhole,
    start_lens,
)

_STEP_PX = 36


@dataclass(kw_only=True)
class Survey:
    """Captures of several targets, and where the camera really stood at each."""

    noise_px: float = 0.02
    seed: int = 11
    captures: list[GeometryCapture] = field(default_factory=list)
    stood: dict[str, CameraPose] = field(default_factory=dict)

    def add(
        self,
        target: str,
        poses: Sequence[CameraPose],
        *,
        kind: str = "texture",
        heights_mm: Sequence[float] | None = None,
        orientation_deg: float = 0.0,
    ) -> "Survey":
        """Add the captures of a target; ``heights_mm`` is read back where it is not the truth."""
        read = [pose.height_mm for pose in poses] if heights_mm is None else heights_mm
        for number, (pose, height_mm) in enumerate(zip(poses, read, strict=True)):
            name = f"{target}-{orientation_deg:g}-{number}.tif"
            self.stood[name] = pose
            self.captures.append(
                GeometryCapture(
                    name=name,
                    kind=kind,
                    target=target,
                    orientation_deg=orientation_deg,
                    height_mm=height_mm,
                    image=np.zeros((HEIGHT_PX, WIDTH_PX)),
                )
            )
        return self

    def adjusted(
        self, captures: Sequence[GeometryCapture] | None = None, lens: PlaneLens | None = None
    ) -> Adjustment:
        """What matching would give: the points of every placement, all adjusted together."""
        rng = np.random.default_rng(self.seed)
        own = self.captures if captures is None else captures
        camera = pinhole()
        series: list[Series] = []
        matches: list[PlaneMatches] = []
        for _, run in groupby(own, key=lambda capture: capture.placement):
            members = list(run)
            stood = [self.stood[capture.name] for capture in members]
            distances = np.array([camera.distance_mm(pose.height_mm) for pose in stood])
            is_board = members[0].kind == "board"
            if is_board:
                matches += _board_points(camera, members, stood, self.noise_px, rng)
            else:
                distances /= distances[0]
                matches += exact_matches(
                    camera, members, stood, noise_px=self.noise_px, rng=rng, step_px=_STEP_PX
                )
            posed = tuple(
                PosedCapture(capture=capture, pose=CapturePose(log_distance=float(np.log(d))))
                for capture, d in zip(members, distances, strict=True)
            )
            series.append(Series(lens=lens or start_lens(), captures=posed, is_in_mm=is_board))
        return adjust(series, matches)


def _board_points(
    camera: PinholeCamera,
    captures: Sequence[GeometryCapture],
    stood: Sequence[CameraPose],
    noise_px: float,
    rng: np.random.Generator,
) -> list[PlaneMatches]:
    """Corners 8 mm apart, about the middle of the board, as far as the frame shows them."""
    x, y = (axis.ravel() for axis in np.mgrid[-72.0:73.0:8.0, -56.0:57.0:8.0])
    parts = []
    for capture, pose in zip(captures, stood, strict=True):
        seen = np.column_stack(camera.to_pixel(x, y, pose))
        inside = np.all((seen >= 4) & (seen <= (WIDTH_PX - 5, HEIGHT_PX - 5)), axis=1)
        count = int(inside.sum())
        parts.append(
            PlaneMatches(
                capture=capture,
                seen_px=seen[inside] + rng.normal(0, noise_px, (count, 2)),
                other=None,
                other_points=np.column_stack([x, y])[inside],
                covariance_px2=np.tile(np.eye(2) * noise_px**2, (count, 1, 1)),
            )
        )
    return parts
