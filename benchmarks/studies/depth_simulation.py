"""Follow-ups of scenes with depth, simulated from a depth map, beside rays followed to the scene.

Rendered twice from two poses (``benchmarks/truth/depth.py``): hills, plates above a ground, and
both, with up to 40 px of parallax, tilts up to 15 degrees, zooms from 1 to 1.6. Told are the depth
of the reference's pixels, the focal length and the ground's homography. Errors are stated over the
follow-up's contrast; what the same pose does to the flat ground alone is what sampling costs.
Beside it: the ground's homography for all, and OpenCV's ``remap`` by the true places of a reference
that was blurred as much as the zoom of the ground asks for.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.studies.depth_simulation [--quick] [--seed N]
"""

from dataclasses import dataclass, replace
from functools import partial
from math import hypot, radians, sqrt, tan
from typing import Annotated

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from benchmarks.harness import Recorder, benchmark, outcomes
from benchmarks.truth.depth import DepthKind, DepthPair, View, depth_pair, depth_scene
from simulation import GaussianPsf, SceneDepth, simulate_pose_of_image
from simulation.arrays import BoolArray, FloatArray, FloatImage
from simulation.pose import DepthRendering, DepthView

PAIRS, QUICK_PAIRS = 30, 3
KINDS: tuple[DepthKind, ...] = ("hills", "plates", "both")
PSF = GaussianPsf(sigma_px=hypot(0.7, sqrt(2 / 27)))
"""Of the renderer: a Gaussian, and three rays along a pixel."""

STEP_PX = 4.0
"""Difference of heights within 3 px from which on there is a step."""

BESIDE_STEPS_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthErrors:
    """Errors of one follow-up, over its contrast, where both photographs see the same.

    ``apart``: away from steps and borders; ``flat``: of the ground alone there; ``everywhere``,
    ``plane``, ``remap``: beside steps too, by us, the homography, and OpenCV. ``hidden_px``:
    pixels that are hidden; ``wrong_px``: those that are said to be and are not, or the other way,
    beyond 1 px.
    """

    kind: str
    parallax_px: float
    apart: float
    flat: float
    everywhere: float
    plane: float
    remap: float
    hidden_px: int
    wrong_px: int


def depth_errors(kind: DepthKind, parallax_px: float, tilt_deg: float, zoom: float) -> DepthErrors:
    """Simulate and render one pair; its scene follows from the numbers."""
    number = round(1000 * (parallax_px + tilt_deg + zoom))
    made = depth_scene(kind, number, parallax_px, tan(radians(tilt_deg)))
    near = View()
    far = View(
        distance_px=near.distance_px * zoom,
        tilt_deg=tilt_deg,
        bearing_deg=float(number % 360),
        roll_deg=3.0,
    )
    pair = depth_pair(made, near, far)
    rows, cols = made.frame
    matrix = ground_homography(pair)
    y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
    scene = SceneDepth(
        depth=near.distance_px - made.points(near, x, y)[0][2],
        focal_length_px=near.focal_px,
        plane_depth=near.distance_px,
    )
    reference = pair.reference_dn.astype(np.float64)
    view = DepthView.of_homography(scene, matrix, (cols, rows))
    rendering = DepthRendering.of(scene, view, PSF)
    found = rendering.photograph(reference)
    plane = simulate_pose_of_image(reference, matrix, (cols, rows), PSF)
    ground = depth_pair(replace(made, hills=(), plates=()), near, far)
    flat = simulate_pose_of_image(ground.reference_dn.astype(np.float64), matrix, (cols, rows), PSF)
    blurred = cv2.GaussianBlur(reference, (0, 0), PSF.sigma_x_px * sqrt(max(zoom**2 - 1, 1e-4)))
    to_y, to_x = pair.places_px.astype(np.float32)
    remapped = np.asarray(cv2.remap(blurred, to_x, to_y, cv2.INTER_CUBIC), np.float64)
    shown = ~(rendering.seen.hidden | rendering.seen.outside)
    both = shown & pair.is_seen
    contrast = float(np.std(pair.followup_dn[both]))

    def error(image: FloatImage, where: BoolArray) -> float:
        return float(np.sqrt(np.mean(np.square(image - pair.followup_dn)[where]))) / contrast

    on_ground = _away_from_steps(ground, ground.is_seen & ~flat.outside)
    apart = np.where(
        shown, distance_transform_edt(pair.is_seen), distance_transform_edt(~pair.is_seen)
    )
    return DepthErrors(
        kind=kind,
        parallax_px=parallax_px,
        apart=error(found.image, both & _away_from_steps(pair, both)),
        flat=float(np.std((flat.image - ground.followup_dn)[on_ground]))
        / float(np.std(ground.followup_dn[on_ground])),
        everywhere=error(found.image, both),
        plane=error(plane.image, both & ~plane.outside),
        remap=error(remapped, both),
        hidden_px=int(np.count_nonzero(~pair.is_seen & ~rendering.seen.outside)),
        wrong_px=int(np.count_nonzero((shown != pair.is_seen) & (apart > 1.01))),
    )


def ground_homography(pair: DepthPair) -> FloatArray:
    """The homography of the ground, by the places of its corners."""
    rows, cols = pair.is_seen.shape
    corners = [(0, 0), (0, cols - 1), (rows - 1, cols - 1), (rows - 1, 0)]
    terms, target = [], []
    for row, col in corners:
        v, u = pair.plane_px[:, row, col].tolist()
        terms.append([col, row, 1, 0, 0, 0, -u * col, -u * row])
        terms.append([0, 0, 0, col, row, 1, -v * col, -v * row])
        target += [u, v]
    exact = np.linalg.solve(np.array(terms, dtype=np.float64), np.array(target))
    return np.append(exact, 1.0).reshape(3, 3)


def _away_from_steps(pair: DepthPair, both: BoolArray) -> BoolArray:
    """Pixels away from steps of either photograph: those of the reference end in hidden parts."""
    height = pair.height_px
    is_step = maximum_filter(height, 3) - minimum_filter(height, 3) > STEP_PX
    edge = is_step | ~both
    return np.asarray(distance_transform_edt(~edge) > BESIDE_STEPS_PX)


def _errors(seed: int, task: tuple[int, DepthKind]) -> DepthErrors:
    number, kind = task
    rng = np.random.default_rng([seed, number])
    return depth_errors(kind, rng.uniform(4, 40), rng.uniform(3, 15), rng.uniform(1, 1.6))


@benchmark("opencv-contrib-python-headless")
def main(
    record: Recorder,
    *,
    seed: Annotated[int, "of the scenes"] = 1,
    pairs: Annotated[int, "pairs, in turns of the kinds"] = 0,
    workers: Annotated[int, "processes"] = 2,
) -> None:
    """Measure all pairs, and say what holds by kind."""
    count = pairs or record.pick(PAIRS, QUICK_PAIRS)
    tasks = [(number, KINDS[number % len(KINDS)]) for number in range(count)]
    rows = []
    for task, row in outcomes(partial(_errors, seed), tasks, workers):
        if not isinstance(row, DepthErrors):
            raise TypeError(f"pair {task}") from row
        rows.append(row)
        record.say(
            f"{row.kind:7s} {row.parallax_px:4.0f} px  error {row.apart:.4f} "
            f"(flat {row.flat:.4f}), everywhere {row.everywhere:.4f}, "
            f"plane {row.plane:.3f}, remap {row.remap:.4f}  "
            f"hidden {row.hidden_px}, wrong {row.wrong_px}"
        )
    for kind in KINDS:
        own = [row for row in rows if row.kind == kind]
        for name, peer in (("apart", "flat"), ("everywhere", "plane"), ("everywhere", "remap")):
            ours, theirs = (
                float(np.median([getattr(row, one) for row in own])) for one in (name, peer)
            )
            record.figure(f"{kind}: error {name}", ours, "of the contrast", peer, theirs)
        worst = max(row.apart / (row.flat + 0.01) for row in own)
        record.figure(
            f"{kind}: error away from steps over that of the flat ground + .01", worst, ""
        )
        record.figure(f"{kind}: hidden or not, wrong", sum(r.wrong_px for r in own), "px")
