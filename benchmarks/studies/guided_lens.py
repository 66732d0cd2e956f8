"""What the frames of one approach could tell of another lens: its distortion and its breathing.

The least standard errors that any fit could reach (Cramér-Rao) from the places of the reference's
corners in the frames of an approach, before a plane. Free are the pose of every frame, and for the
lens: its focal length over the reference's, its k1 (radii grow by ``1 + k1 r**2``, r = 1 in the
corners), and its breathing (the focal length grows by so much from the reference's distance to
twice as far). Corners are off by .3 px along each axis, as the tracking's residuals are.

    python -m benchmarks.studies.guided_lens [--seed 1]
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.harness import Recorder, benchmark

FRAME = (640, 480)
FOCAL_PX = 0.9 * 640
CORNER_ERR_PX = 0.3
CORNERS = (12, 9)
FRAMES = 20
APPROACHES = 20
STEP = 1e-5

Vector = NDArray[np.float64]


def corners_seen(poses: Vector, lens: Vector) -> Vector:
    """Places of all corners in all frames, px, from the middle.

    ``poses``: shape (n, 6), centre in distances and turn in radians. ``lens``: ln of the focal
    length over the reference's, k1, breathing.
    """
    across, down = (np.linspace(-0.45, 0.45, count) for count in CORNERS)
    plane = np.stack(np.meshgrid(across * FRAME[0], down * FRAME[1]), -1).reshape(-1, 2) / FOCAL_PX
    world = np.column_stack((plane, np.ones(len(plane))))
    half_px = np.hypot(*FRAME) / 2
    found = []
    for pose in poses:
        seen = (world - pose[:3]) @ Rotation.from_rotvec(pose[3:]).as_matrix()
        breathing = 1 + lens[2] * 2 * (1 - 1 / (1 - pose[2]))
        places = FOCAL_PX * np.exp(lens[0]) * breathing * seen[:, :2] / seen[:, 2:]
        radius2 = np.sum(places**2, axis=1, keepdims=True) / half_px**2
        found.append(places * (1 + lens[1] * radius2))
    return np.concatenate(found).ravel()


def least_errors(poses: Vector, free: list[int]) -> Vector:
    """Least standard errors of these parameters of the lens, with the poses free."""
    count = poses.size
    point = np.concatenate((poses.ravel(), np.zeros(3)))

    def seen(values: Vector) -> Vector:
        return corners_seen(values[:count].reshape(-1, 6), values[count:])

    wanted = [*range(count), *(count + one for one in free)]
    slopes = []
    for one in wanted:
        step = np.zeros(len(point))
        step[one] = STEP
        slopes.append((seen(point + step) - seen(point - step)) / (2 * STEP))
    jacobian = np.stack(slopes, axis=1) / CORNER_ERR_PX
    covariance = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-14, hermitian=True)
    return np.asarray(np.sqrt(np.diag(covariance)[count:]), dtype=np.float64)


def approach(rng: np.random.Generator, tilt_deg: float) -> Vector:
    """Poses from 1.2 to 1.6 times as far to the reference's own, with so much tilt on the way."""
    left = np.linspace(1, 0, FRAMES)[:, None]
    start = np.array([*rng.uniform(-0.1, 0.1, 2), -rng.uniform(0.2, 0.6)])
    turn = np.radians([*rng.uniform(-tilt_deg, tilt_deg, 2), rng.uniform(-15, 15)])
    sway = np.radians(0.25) * rng.standard_normal((FRAMES, 3))
    return np.hstack((left * start, left * turn + sway))


KINDS = {"focal length": [0], "k1": [1], "breathing": [2], "all three: k1": [0, 1, 2]}


@benchmark("numpy", "scipy")
def main(record: Recorder, *, seed: Annotated[int, "of the approaches"] = 1) -> None:
    """Least errors of a lens from approaches with little and with much tilt."""
    record.say("  least standard error, median of the approaches and largest")
    for tilt_deg in (2.0, 10.0):
        for name, free in KINDS.items():
            rng = np.random.default_rng(seed)
            found = [
                least_errors(approach(rng, tilt_deg), free)[1 if len(free) > 1 else 0]
                for _ in range(record.pick(APPROACHES, 3))
            ]
            middle, largest = 100 * float(np.median(found)), 100 * float(np.max(found))
            record.say(f"  tilt {tilt_deg:4.0f}°  {name:16} {middle:8.3f} % {largest:8.3f} %")
            record.figure(f"tilt {tilt_deg:g}: {name}", middle, "%")
