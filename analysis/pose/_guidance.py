"""Which way a hand-held camera has to move to stand where the reference was taken from.

A homography in, words and amounts out. The reference is taken to have looked straight at a plane,
which leaves one pose for a homography (Zhang 2000, section 3.1). For an oblique reference the
amounts are off by the cosine of its tilt, but still vanish exactly where the reference was taken.

References
----------
Z. Zhang, "A flexible new technique for camera calibration", IEEE Trans. PAMI 22 (2000), 1330-1334.
"""

from dataclasses import dataclass
from math import atan2, degrees, hypot
from typing import Final, Literal

import numpy as np

from simulation.arrays import FloatArray
from simulation.pose import project

FOCAL_PER_LONG_SIDE: Final = 0.8
"""Focal length over the longer side of the picture, of a phone's main camera (some 64 degrees).
Another one only scales the angles."""

Cost = Literal["distance", "aim", "turn", "tilt"]

TOLERANCES: Final[dict[Cost, float]] = {"distance": 0.03, "aim": 0.02, "turn": 2.0, "tilt": 2.0}
"""Good enough up to these: relative distance, share of the longer side, degrees, degrees."""

_AT_ONCE = 2
_RELEASED_AT = 0.55
"""Share of a tolerance below which an arrow is not shown, so that a hand does not oscillate."""

_NEARLY_LOST = 0.3
"""Share of the frame from which aiming comes first: beyond it the scene is soon out of sight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrow:
    """One movement of the camera: its ``name``, how much, and that amount in words.

    ``amount`` is in percent of the distance for ``nearer`` and ``further``, in percent of the
    longer side for ``left``, ``right``, ``up`` and ``down``, else in degrees.
    """

    name: str
    amount: float
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDeviation:
    """How the camera stands relative to the reference's pose, where all is 0 and ``distance`` 1.

    Parameters
    ----------
    distance
        Distance along the optical axis over that of the reference.
    right, down
        How far the middle of the reference appears right of and below the middle of the frame, in
        shares of its longer side: where the camera has to move to.
    clockwise_deg
        How far the camera has to be turned about its optical axis, clockwise as its user sees it.
    tilt_right_deg, tilt_down_deg
        How far the optical axis has to be swung to the right and down.
    """

    distance: float
    right: float
    down: float
    clockwise_deg: float
    tilt_right_deg: float
    tilt_down_deg: float

    @property
    def costs(self) -> dict[Cost, float]:
        """Each deviation as a multiple of its tolerance."""
        found: dict[Cost, float] = {
            "distance": abs(self.distance - 1),
            "aim": hypot(self.right, self.down),
            "turn": abs(self.clockwise_deg),
            "tilt": hypot(self.tilt_right_deg, self.tilt_down_deg),
        }
        return {name: value / TOLERANCES[name] for name, value in found.items()}

    @property
    def largest_cost(self) -> float:
        """The largest deviation as a multiple of its tolerance: good enough up to 1."""
        return max(self.costs.values())

    def arrows(self) -> tuple[Arrow, ...]:
        """Return the movements that matter most, at most two, the most urgent first."""
        ranked = sorted(self._candidates(), key=lambda one: -one[0])
        if hypot(self.right, self.down) > _NEARLY_LOST:
            ranked.sort(key=lambda one: one[1].name not in ("left", "right", "up", "down"))
        return tuple(arrow for cost, arrow in ranked if cost > _RELEASED_AT)[:_AT_ONCE]

    def _candidates(self) -> list[tuple[float, Arrow]]:
        percent = 100 * (self.distance - 1)
        signed: tuple[tuple[Cost, float, str, str, str], ...] = (
            ("distance", percent, "nearer", "further", "{:.0f} %"),
            ("aim", 100 * self.right, "right", "left", "{:.0f} % of the picture"),
            ("aim", 100 * self.down, "down", "up", "{:.0f} % of the picture"),
            ("turn", self.clockwise_deg, "turn clockwise", "turn anticlockwise", "{:.0f}°"),
            ("tilt", self.tilt_right_deg, "tilt right", "tilt left", "{:.0f}°"),
            ("tilt", self.tilt_down_deg, "tilt down", "tilt up", "{:.0f}°"),
        )
        found = []
        for cost, value, positive, negative, words in signed:
            in_percent = cost in ("distance", "aim")
            tolerance = TOLERANCES[cost] * (100 if in_percent else 1)
            name, amount = (positive if value > 0 else negative), abs(value)
            shown = words.format(max(amount, 1.0))
            arrow = Arrow(name=name, amount=amount, words=f"{name} {shown}")
            found.append((amount / tolerance, arrow))
        return found

    @property
    def sentence(self) -> str:
        """The pose in words, without a verdict."""
        percent = 100 * (self.distance - 1)
        distance = (
            "at the same distance"
            if abs(percent) < 1
            else f"{abs(percent):.0f} % {'further away' if percent > 0 else 'nearer'}"
        )
        aim, turn, tilt = self.costs["aim"], self.clockwise_deg, self.costs["tilt"]
        return (
            f"{distance}, aside by {100 * aim * TOLERANCES['aim']:.0f} % of the picture, turned by "
            f"{abs(turn):.0f}°, tilted by {tilt * TOLERANCES['tilt']:.0f}°"
        )


def pose_deviation(
    matrix: FloatArray,
    size: tuple[int, int],
    reference_size: tuple[int, int],
    focal_ratio: float | None = None,
) -> PoseDeviation:
    """Work out from a homography how the camera has to move.

    Parameters
    ----------
    matrix
        Shape (3, 3): pixel centres ``(x, y, 1)`` of the frame to those of the reference.
    size, reference_size
        ``(width, height)`` of the frame and of the reference in px, the way up they are viewed.
    focal_ratio
        Focal length in px of the frame over that of the reference; by default the ratio of their
        longer sides, as of two pictures with one field of view.

    Raises
    ------
    ValueError
        If the homography is singular, or shows the scene from behind.
    """
    reference_f = FOCAL_PER_LONG_SIDE * max(reference_size)
    ratio = max(size) / max(reference_size) if focal_ratio is None else focal_ratio
    from_plane = np.linalg.inv(_camera(size, ratio * reference_f)) @ np.linalg.solve(
        np.asarray(matrix, dtype=np.float64), _camera(reference_size, reference_f)
    )
    scale = float(np.sqrt(np.linalg.norm(from_plane[:, 0]) * np.linalg.norm(from_plane[:, 1])))
    if not (np.isfinite(from_plane).all() and scale > 0):
        raise ValueError("the homography is singular")
    columns = from_plane / (scale * np.sign(from_plane[2, 2]))
    first, second, place = columns.T
    if not np.linalg.det(columns) > 0:
        raise ValueError("the homography shows the scene from behind")
    left, _, right = np.linalg.svd(np.column_stack((first, second, np.cross(first, second))))
    rotation = left @ right
    # The plane is at 1 along the reference's axis; its foot there is seen at `place`.
    normal = rotation[:, 2]
    distance = float(normal @ place) / float(normal[2])
    width, height = size
    x, y = project(
        np.asarray(np.linalg.inv(matrix), dtype=np.float64),
        np.array([(reference_size[0] - 1) / 2]),
        np.array([(reference_size[1] - 1) / 2]),
    )
    return PoseDeviation(
        distance=distance,
        right=(float(x[0]) - (width - 1) / 2) / max(size),
        down=(float(y[0]) - (height - 1) / 2) / max(size),
        clockwise_deg=degrees(atan2(rotation[1, 0], rotation[0, 0])),
        tilt_right_deg=degrees(atan2(normal[0], normal[2])),
        tilt_down_deg=degrees(atan2(normal[1], normal[2])),
    )


def _camera(size: tuple[int, int], focal_px: float) -> FloatArray:
    width, height = size
    return np.array(
        [[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]]
    )
