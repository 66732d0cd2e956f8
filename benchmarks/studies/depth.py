"""Scenes with depth: parallax, what is hidden, changes that are none, and changes that are.

Rendered twice from two poses (``benchmarks/truth/depth.py``): hills, plates above a ground, and
both, with up to 40 px of parallax, tilts up to 15 degrees, zooms from .75 to 1.6, noise of 1 DN, a
third as JPEG. Of each pair an unchanged follow-up, and one with spots painted on it and things
pasted into it. Beside it: the plane alone (``--flat``), and OpenCV's dense flow, whose difference
is judged by its own scatter. Flat scenes with the same noise say how many spots are found there.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.studies.depth [--quick] [--seed N] [--pairs N]
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from math import radians, tan
from typing import Annotated, Any

import cv2
import numpy as np

from analysis.changes import ChangeOptions, ChangeResult, changes_between, depth_in_mm
from analysis.pose import parallax_cost
from benchmarks.harness import Recorder, benchmark, outcomes
from benchmarks.truth.depth import DepthKind, DepthPair, View, depth_pair, depth_scene
from calibration.errors import CalibrationError
from calibration.parallax import FrameCamera, Viewpoint
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array

PAIRS, QUICK_PAIRS = 48, 4
KINDS: tuple[DepthKind, ...] = ("hills", "plates", "both", "flat")
NOISE_DN = 1.0
JPEG_QUALITY = 92
BORDER_PX = 10
SPOTS, SPOT_SIGMA_PX = 8, 2.0
SPOT_DN = (12.0, 40.0)
THINGS, THING_PX = 2, 18
NEAR_PX = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """What was measured of one pair; distances in px, shares of what is named."""

    kind: str
    parallax_px: float = 0.0
    refused: str = ""
    has_depth: bool = False
    median_px: float = 0.0
    p95_px: float = 0.0
    compared: float = 0.0
    hidden: int = 0
    hidden_found: int = 0
    listed_px: int = 0
    compared_px: int = 0
    listed_flat_px: int = 0
    listed_flow_px: int = 0
    spots: int = 0
    spots_compared: int = 0
    spots_found: int = 0
    things: int = 0
    things_compared: int = 0
    things_found: int = 0
    height_median_px: float | None = None
    height_p95_px: float = 0.0
    height_within: float = 0.0
    distance_off: float = 0.0
    move_deg: float | None = None
    in_line: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Case:
    """A pair with its truth, developed."""

    made: DepthPair
    views: tuple[View, View]
    reference: Float32Array = field(repr=False)
    followup: Float32Array = field(repr=False)
    rng: np.random.Generator


def _case(seed: int, number: int, kind: DepthKind) -> tuple[_Case, float]:
    rng = np.random.default_rng([seed, number])
    tilt_deg = rng.uniform(3, 15)
    parallax_px = rng.uniform(4, 40)
    zoom = rng.uniform(0.75, 1.6)
    scene = depth_scene(kind, 1000 * seed + number, parallax_px, tan(radians(tilt_deg)))
    followup = View(
        distance_px=View().distance_px * zoom,
        tilt_deg=tilt_deg,
        bearing_deg=rng.uniform(0, 360),
        roll_deg=rng.uniform(-5, 5),
    )
    made = depth_pair(scene, View(), followup)
    return (
        _Case(
            made=made,
            views=(View(), followup),
            reference=_developed(made.reference_dn, rng, is_jpeg=number % 3 == 2),
            followup=_developed(made.followup_dn, rng, is_jpeg=number % 3 == 2),
            rng=rng,
        ),
        parallax_px,
    )


def _developed(image: Float32Array, rng: np.random.Generator, *, is_jpeg: bool) -> Float32Array:
    noisy = np.clip(np.rint(image + rng.normal(0, NOISE_DN, image.shape)), 0, 255)
    if is_jpeg:
        flags = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        coded = cv2.imencode(".jpg", noisy.astype(np.uint8), flags)[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.float32)
    return np.asarray(noisy, dtype=np.float32)


def _inner(made: DepthPair) -> BoolArray:
    """Pixels away from both frames' borders."""
    rows, cols = made.is_seen.shape
    inner = np.zeros((rows, cols), dtype=np.bool_)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    y, x = made.places_px
    inner &= (y > BORDER_PX) & (y < rows - 1 - BORDER_PX)
    return np.asarray(inner & (x > BORDER_PX) & (x < cols - 1 - BORDER_PX))


def _depth_figures(case: _Case, found: ChangeResult) -> dict[str, Any]:
    """Errors of heights above the plane of the pose, in px of ground, and of the advice to move."""
    seen, figures = found.parallax, found.summary.parallax
    if seen is None or figures is None:
        return {}
    reference, followup = case.views
    rows, cols = case.followup.shape
    there = followup.rotation @ ((reference.centre - followup.centre) * [1, 1, -1])
    cost = parallax_cost(found.pose, seen, figures).figures
    measured: dict[str, Any] = {"in_line": (cost.in_line_range_px, cost.range_px)}
    if cost.move is not None:
        apart = np.arctan2(*cost.move[::-1]) - np.arctan2(there[1], there[0])
        measured["move_deg"] = float(np.rad2deg(np.abs((apart + np.pi) % (2 * np.pi) - np.pi)))
    camera = FrameCamera(
        focal_length_px=followup.focal_px, principal_px=((cols - 1) / 2, (rows - 1) / 2)
    )
    depth = depth_in_mm(found.pose, (seen, figures), camera, reference.distance_px)
    if depth is None:
        return measured
    viewpoint = Viewpoint.of(found.pose.matrix, np.array(figures.epipole), camera)
    if viewpoint is None or depth.figures.heights is None:
        return measured
    y, x = np.indices((rows, cols)).astype(np.float64)
    along = followup.rays(x, y, (rows, cols))
    points = camera.rays(x, y) * (followup.distance_px - case.made.height_px) / -along[2]
    off = np.tensordot(viewpoint.normal, points, 1)
    distance = depth.figures.heights.distance_mm
    share, err = depth.height_mm / distance, depth.height_error_mm / distance
    known = np.isfinite(depth.height_error_mm) & case.made.is_seen & _inner(case.made)
    # The plane of the pose lies where it lies: its true distance is that which fits.
    true = float(np.median((off / (1 - share))[known]))
    error_px = np.abs(true * share - (true - off))[known]
    return {
        **measured,
        "height_median_px": float(np.median(error_px)),
        "height_p95_px": float(np.percentile(error_px, 95)),
        "height_within": float(np.mean(error_px < 2 * true * err[known])),
        "distance_off": abs(distance / true - 1),
    }


def _flow_listed(case: _Case, found: ChangeResult) -> int:
    """Pixels that differ by five times the scatter after dense flow, where it agrees both ways."""
    rows, cols = case.followup.shape
    at_y, at_x = (one.astype(np.float32) for one in found.pose.plane.followup_places_px())
    aligned = cv2.remap(case.reference, at_x, at_y, cv2.INTER_CUBIC, borderValue=(np.nan,) * 4)
    inside = np.isfinite(aligned)
    own, other = (
        np.clip(np.nan_to_num(one, nan=128.0), 0, 255).astype(np.uint8)
        for one in (case.followup, aligned)
    )
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    there = flow.calc(own, other, np.zeros((rows, cols, 2), np.float32))
    back = flow.calc(other, own, np.zeros((rows, cols, 2), np.float32))
    y, x = np.mgrid[0:rows, 0:cols].astype(np.float32)
    to_x, to_y = x + there[..., 0], y + there[..., 1]
    again = cv2.remap(back, to_x, to_y, cv2.INTER_LINEAR)
    agrees = inside & (np.hypot(*(there + again).transpose(2, 0, 1)) < 1.5)
    seen = cv2.remap(np.nan_to_num(aligned), to_x, to_y, cv2.INTER_CUBIC)
    smooth = [
        cv2.GaussianBlur(np.asarray(one, np.float32), (0, 0), 1.2) for one in (case.followup, seen)
    ]
    apart = (smooth[0] - smooth[1])[agrees]
    return int(np.count_nonzero(np.abs(apart - np.median(apart)) > 5 * robust_sigma(apart)))


def _changed(case: _Case) -> tuple[Float32Array, list[tuple[float, float]], list[tuple[int, int]]]:
    """The follow-up with spots painted on it and patches pasted into it, and their places."""
    rng, made = case.rng, case.made
    rows, cols = made.is_seen.shape
    sound = cv2.erode((_inner(made) & made.is_seen).astype(np.uint8), np.ones((25, 25), np.uint8))
    image = case.followup.copy()
    y, x = np.mgrid[0:rows, 0:cols]
    taken = np.zeros((rows, cols), dtype=np.bool_)
    spots, things = [], []
    for number in range(THINGS + SPOTS):
        at = np.argwhere((sound > 0) & ~taken)
        if not len(at):
            break
        row, col = at[rng.integers(len(at))].tolist()
        taken |= np.hypot(y - row, x - col) < 45
        if number < THINGS:
            half = THING_PX // 2
            part = np.s_[row - half : row + half, col - half : col + half]
            far = (row + rows // 2) % (rows - THING_PX), (col + cols // 3) % (cols - THING_PX)
            image[part] = case.followup[far[0] : far[0] + 2 * half, far[1] : far[1] + 2 * half]
            things.append((row, col))
        else:
            peak = rng.uniform(*SPOT_DN) * rng.choice([-1, 1])
            image += peak * np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * SPOT_SIGMA_PX**2))
            spots.append((float(row), float(col)))
    return np.asarray(np.rint(image), dtype=np.float32), spots, things


def _row(seed: int, task: tuple[int, DepthKind]) -> _Row:
    number, kind = task
    case, parallax_px = _case(seed, number, kind)
    made = case.made
    try:
        found = changes_between(case.reference, case.followup)
        plane = changes_between(case.reference, case.followup, options=ChangeOptions(flat=True))
    except CalibrationError as error:
        return _Row(kind=kind, parallax_px=parallax_px, refused=str(error)[:60])
    inner = _inner(made)
    seen = found.pose.followup_seen()
    y, x = found.pose.followup_places_px()
    error_px = np.hypot(y - made.places_px[0], x - made.places_px[1])
    both = inner & made.is_seen & found.valid
    hidden = inner & ~made.is_seen
    image, spots, things = _changed(case)
    changed = changes_between(case.reference, image)
    half = THING_PX // 2
    compared_things = [
        found.valid[row - half : row + half, col - half : col + half].mean() > 0.5
        for row, col in things
    ]
    # What is listed there anyway was not found.
    found_things, false_things = (
        [
            bool(one.is_change[row - half : row + half, col - half : col + half].any())
            for row, col in things
        ]
        for one in (changed, found)
    )
    compared_spots = [bool(found.valid[round(row), round(col)]) for row, col in spots]
    found_spots, false_spots = (
        [is_listed(one, row, col) for row, col in spots] for one in (changed, found)
    )
    return _Row(
        kind=kind,
        parallax_px=parallax_px,
        has_depth=seen is not None,
        median_px=float(np.median(error_px[both])),
        p95_px=float(np.percentile(error_px[both], 95)),
        compared=float(np.mean(found.valid[inner & made.is_seen])),
        hidden=int(np.count_nonzero(hidden)),
        hidden_found=int(np.count_nonzero(hidden & ~found.valid)),
        listed_px=found.summary.changed_px,
        compared_px=found.summary.compared_px,
        listed_flat_px=plane.summary.changed_px,
        listed_flow_px=_flow_listed(case, found),
        spots=len(spots),
        spots_compared=sum(compared_spots),
        spots_found=_count(compared_spots, found_spots, false_spots),
        things=len(things),
        things_compared=sum(compared_things),
        things_found=_count(compared_things, found_things, false_things),
        **_depth_figures(case, found),
    )


def _count(compared: Sequence[bool], found: Sequence[bool], false: Sequence[bool]) -> int:
    return sum(a and b and not c for a, b, c in zip(compared, found, false, strict=True))


def is_listed(found: ChangeResult, row: float, col: float) -> bool:
    """Whether anything is listed within ``NEAR_PX`` of a pixel of the follow-up."""
    every = (*found.summary.changes, *found.summary.moved)
    places = [part for one in every for part in (one, *one.parts)]
    return any(np.hypot(one.y_px - row, one.x_px - col) < NEAR_PX for one in places)


def _say_kind(record: Recorder, kind: DepthKind, rows: list[_Row]) -> None:
    measured = [row for row in rows if not row.refused]
    if not measured:
        return
    record.figure(f"{kind}: refused", len(rows) - len(measured), f"of {len(rows)}")
    record.figure(f"{kind}: with depth", sum(row.has_depth for row in measured), f"of {len(rows)}")
    record.figure(f"{kind}: error, median", float(np.median([r.median_px for r in measured])), "px")
    worst = max(row.median_px for row in measured)
    record.figure(f"{kind}: error, median of the worst pair", worst, "px")
    record.figure(f"{kind}: error, 95 %", float(np.median([r.p95_px for r in measured])), "px")
    record.figure(f"{kind}: compared", float(np.mean([r.compared for r in measured])), "")
    hidden = sum(row.hidden for row in measured)
    if hidden:
        found = sum(row.hidden_found for row in measured) / hidden
        record.figure(f"{kind}: hidden parts found", found, "")
    listed, plane, flow = (
        sum(getattr(row, name) for row in measured)
        for name in ("listed_px", "listed_flat_px", "listed_flow_px")
    )
    total = sum(row.compared_px for row in measured)
    record.figure(f"{kind}: listed of nothing", 100 * listed / total, "% of what was compared")
    record.figure(f"{kind}: listed of nothing, beside a plane", listed, "px", "plane", plane)
    record.figure(f"{kind}: listed of nothing, beside dense flow", listed, "px", "flow", flow)
    for name, unit in (
        *(("height_median_px", "px"), ("height_p95_px", "px")),
        *(("height_within", ""), ("distance_off", "")),
    ):
        those = [getattr(row, name) for row in measured if row.height_median_px is not None]
        if those:
            record.figure(f"{kind}: {name}", float(np.median(those)), unit)
    moves = [row.move_deg for row in measured if row.move_deg is not None]
    if moves:
        record.figure(f"{kind}: direction to move in, worst", max(moves), f"deg, of {len(moves)}")
    for name in ("spots", "things"):
        compared = sum(getattr(row, f"{name}_compared") for row in measured)
        share = sum(getattr(row, f"{name}_found") for row in measured) / max(compared, 1)
        record.figure(f"{kind}: {name} found where compared", share, f"of {compared}")


@benchmark()
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
    for task, row in outcomes(partial(_row, seed), tasks, workers):
        if not isinstance(row, _Row):
            raise TypeError(f"pair {task}") from row
        rows.append(row)
        record.say(
            f"{row.kind:7s} {row.parallax_px:4.0f} px  {row.refused or row.has_depth!s:5s}  error "
            f"{row.median_px:.3f} {row.p95_px:.2f}  compared {row.compared:.2f}  hidden "
            f"{row.hidden_found}/{row.hidden}  listed {row.listed_px} (plane {row.listed_flat_px}, "
            f"flow {row.listed_flow_px}) of {row.compared_px}  spots {row.spots_found}/"
            f"{row.spots_compared}/{row.spots}  things {row.things_found}/{row.things_compared}/"
            f"{row.things}  height {row.height_median_px} {row.height_p95_px:.2f} "
            f"{row.height_within:.2f} {row.distance_off:.3f}  move {row.move_deg}  in line "
            f"{row.in_line}"
        )
    for kind in KINDS:
        _say_kind(record, kind, [row for row in rows if row.kind == kind])
