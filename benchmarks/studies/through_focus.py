"""Focus over the field against closed forms: errors, coverage of the intervals, and nulls.

Charts of slanted squares through focus, behind lenses whose tangential and sagittal foci, tilt and
depth of focus are known (``benchmarks/truth/focus_scenes.py``); the picture grows with the focus,
as behind a lens that breathes. Then edges behind a perfect lens with defocus, whose contrast is
that of Hopkins and not Gaussian. And lenses without tilt, curvature or astigmatism, for which all
of that must be 0 within the intervals, and charts that do not change with the position.

``Drawn``: the contrasts of edges in closed form with normal errors, as many as are stated, without
any picture: thousands of intervals of the field, of many edges and of few.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import cos, pi, radians, sin

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.focus_scenes import FocusedLens, chart, squares
from benchmarks.truth.lenses import edge_photographs, f_number
from calibration.edges import EdgeImage, EdgeMeasurement, EdgeSelection
from calibration.estimate import NORMAL_95
from calibration.lens import FocusPoint, StatedContrast, ThroughFocus, through_focus
from calibration.sharpness import MeasuredValue, Picture
from simulation.arrays import FloatArray

SIZE_PX = (800, 600)
COLUMNS, ROWS, HALF_PX, TURN_DEG = 5, 4, 32.0, 6.0
POSITIONS_MM = tuple(np.round(np.linspace(-0.3, 0.3, 13), 3).tolist())
STATED = StatedContrast(contrast=0.2, freq_cy_per_px=0.2)
NOISE_DN = 24.0
"""A hundredth of the contrast."""
BREATHING_PER_MM = 0.05
SHARES = tuple(np.round(np.linspace(-1.5, 1.5, 13), 3).tolist())
"""Of half the depth of focus of an upright edge."""
_MOST_WAVES = 1.0 / 0.03
F_NUMBERS = (2.8, 8.0, 16.0)


def drawn_lens(rng: np.random.Generator) -> FocusedLens:
    """A lens with tilt, curvature and astigmatism, each of a tenth to a half of the depth."""
    signs = rng.choice([-1.0, 1.0], 4)
    bend, other, tilt_x, tilt_y = (signs * rng.uniform(0.03, 0.12, 4)).tolist()
    return FocusedLens(
        width_px=SIZE_PX[0],
        height_px=SIZE_PX[1],
        best_mm=float(rng.uniform(-0.05, 0.05)),
        sigma_px=float(rng.uniform(0.45, 0.8)),
        blur_px_per_mm=float(rng.uniform(7.0, 10.0)),
        tangential_mm=bend,
        sagittal_mm=other,
        tilt_x_mm=tilt_x,
        tilt_y_mm=tilt_y,
    )


def clean_series(lens: FocusedLens) -> list[FloatArray]:
    """Photographs of the chart at all positions, without noise."""
    middles = squares(lens, COLUMNS, ROWS)
    return [
        chart(lens, middles, HALF_PX, TURN_DEG, one, 1 + BREATHING_PER_MM * one)
        for one in POSITIONS_MM
    ]


def measured(clean: Sequence[FloatArray], rng: np.random.Generator) -> ThroughFocus | None:
    """Measure a series with noise."""
    edges: list[EdgeMeasurement] = []
    for position, image in zip(POSITIONS_MM, clean, strict=True):
        noisy = image + rng.normal(0, NOISE_DN, image.shape)
        edges += EdgeSelection().measured_in(
            EdgeImage(name=f"{position}", image_dn=noisy), "all-angles"
        )
    picture = Picture(width_px=SIZE_PX[0], height_px=SIZE_PX[1], pixel_pitch_um=5.0)
    return through_focus(edges, {f"{one}": one for one in POSITIONS_MM}, picture, STATED, "focus")


def compared(lens: FocusedLens, found: ThroughFocus) -> Iterator[tuple[str, MeasuredValue, float]]:
    """Name, value and truth of every figure."""
    field = found.field
    if field is None:
        raise ValueError("the chart covers the field")
    yield "best focus", found.best_mm, lens.best_mm
    yield "tilt, left to right", field.tilt_x_mm, lens.tilt_x_mm
    yield "tilt, top to bottom", field.tilt_y_mm, lens.tilt_y_mm
    yield "tangential", field.tangential_mm, lens.tangential_mm
    yield "sagittal", field.sagittal_mm, lens.sagittal_mm
    yield "curvature", field.curvature_mm, 0.5 * (lens.tangential_mm + lens.sagittal_mm)
    yield "astigmatism", field.astigmatism_mm, lens.tangential_mm - lens.sagittal_mm
    if found.depth_mm is not None:
        depths = [_true_depth(lens, one) for one in found.points if one.depth_mm is not None]
        yield "depth, median", found.depth_mm, float(np.median(depths))
    if found.common_depth_mm is not None:
        ends = [_true_ends(lens, one) for one in found.points]
        common = min(end for _, end in ends) - max(end for end, _ in ends)
        yield "depth, common", found.common_depth_mm, common


def _normal(point: FocusPoint) -> float:
    return radians(point.angle_deg) + pi / 2


def _true_depth(lens: FocusedLens, point: FocusPoint) -> float:
    at = (point.x_px, point.y_px)
    return lens.depth_mm(at, _normal(point), STATED.contrast, STATED.freq_cy_per_px)


def _true_ends(lens: FocusedLens, point: FocusPoint) -> tuple[float, float]:
    best, _ = lens.best_across(point.x_px, point.y_px, _normal(point))
    half = 0.5 * _true_depth(lens, point)
    return best - half, best + half


def _of_lenses(record: Recorder, seed: int, lenses: int, draws: int, what: str) -> None:
    rng = np.random.default_rng(seed)
    off: dict[str, list[float]] = {}
    covered: dict[str, list[bool]] = {}
    at_points: list[bool] = []
    for _ in range(lenses):
        lens = drawn_lens(rng)
        depth = lens.depth_mm((400.0, 300.0), 0.0, STATED.contrast, STATED.freq_cy_per_px)
        clean = clean_series(lens)
        for _ in range(draws):
            found = measured(clean, rng)
            if found is None:
                raise ValueError("the series has a best focus")
            for name, value, truth in compared(lens, found):
                off.setdefault(name, []).append(100 * abs(value.value - truth) / depth)
                covered.setdefault(name, []).append(_covers(value, truth))
            at_points += [
                _covers(one.best_mm, lens.best_across(one.x_px, one.y_px, _normal(one))[0])
                for one in found.points
            ]
    record.say(f"\n{what}: largest and rms error in % of the depth of focus, covered at 95 %")
    for name, values in off.items():
        record.say(
            f"  {name:22s} {max(values):6.2f} {np.sqrt(np.mean(np.square(values))):6.2f} "
            f"{100 * np.mean(covered[name]):6.1f} % of {len(values)}"
        )
    record.figure(f"largest error of any figure, {what}", max(map(max, off.values())), "%")
    all_of = [one for name in covered for one in covered[name]]
    record.figure(f"intervals that cover, {what}", 100 * float(np.mean(all_of)), "%")
    record.figure(
        f"best focus of single edges, covered, {what}", 100 * float(np.mean(at_points)), "%"
    )


def _covers(value: MeasuredValue, truth: float) -> bool:
    return bool(abs(value.value - truth) <= NORMAL_95 * value.err)


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnSfr:
    """What an edge's e-SFR says at the stated frequency, with its standard error."""

    contrast: float
    err: float

    def transform(self, freq_cy_per_px: FloatArray) -> NDArray[np.complex128]:
        """The contrast, whatever the frequency."""
        return np.full(freq_cy_per_px.shape, self.contrast, np.complex128)

    def transform_err(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Its error."""
        return np.full(freq_cy_per_px.shape, self.err)


def drawn_edges(
    lens: FocusedLens, middles: Sequence[tuple[float, float]], rng: np.random.Generator
) -> list[EdgeMeasurement]:
    """Four edges about each middle at all positions, whose contrasts have errors of half a %."""
    template, length = _template(), 2 * HALF_PX
    found = []
    for position in POSITIONS_MM:
        growth = 1 + BREATHING_PER_MM * position
        for (x, y), side in product(middles, range(4)):
            normal = radians(TURN_DEG + 90 * side)
            away = np.array([cos(normal), sin(normal)])
            middle = np.array([(SIZE_PX[0] - 1) / 2, (SIZE_PX[1] - 1) / 2])
            at = middle + growth * (np.array([x, y]) + HALF_PX * away - middle)
            along = np.linspace(-0.4, 0.4, 5) * length
            places = at[:, None] + np.array([-away[1], away[0]])[:, None] * along
            sigma = lens.sigma_across(places[0], places[1], normal, position)
            freq = STATED.freq_cy_per_px
            true = float(
                np.mean([lens.contrast_across(s**2, normal, freq) for s in sigma.tolist()])
            )
            update = {
                "image": f"{position}",
                **{"x_px": float(at[0]), "y_px": float(at[1])},
                "angle_deg": TURN_DEG + 90 * side - 90,
                "length_px": 0.8 * length,
                "levels_dn": (400.0, 2800.0) if side < 2 else (2800.0, 400.0),
                "esfr": DrawnSfr(contrast=true + rng.normal(0, 0.005), err=0.005),
            }
            found.append(template.model_copy(update=update))
    return found


def _template() -> EdgeMeasurement:
    """An edge that is used."""
    lens = replace(drawn_lens(np.random.default_rng(1)), width_px=120, height_px=120)
    image = chart(lens, [(60.0, 60.0)], HALF_PX, TURN_DEG, lens.best_mm)
    found = EdgeSelection().measured_in(EdgeImage(name="edge", image_dn=image), "all-angles")
    return next(edge for edge in found if edge.is_used)


def _of_drawn(record: Recorder, draws: int) -> None:
    """Coverage of tilt and curvatures where contrasts are drawn."""
    rng = np.random.default_rng(2233)
    picture = Picture(width_px=SIZE_PX[0], height_px=SIZE_PX[1], pixel_pitch_um=5.0)
    positions = {f"{one}": one for one in POSITIONS_MM}
    for columns, rows in ((5, 4), (3, 2), (2, 1)):
        covered: dict[str, list[bool]] = {}
        for _ in range(draws):
            lens = drawn_lens(rng)
            edges = drawn_edges(lens, squares(lens, columns, rows), rng)
            found = through_focus(edges, positions, picture, STATED, "focus")
            if found is None or found.field is None:
                continue
            for name, value, truth in compared(lens, found):
                if not name.startswith("depth"):
                    covered.setdefault(name, []).append(_covers(value, truth))
        bent = [one for name in ("tangential", "sagittal", "curvature", "astigmatism")
                for one in covered[name]]  # fmt: skip
        said = ", ".join(f"{name} {100 * np.mean(one):.1f}" for name, one in covered.items())
        record.say(
            f"drawn, {4 * columns * rows} edges: covered in %: {said}; {len(bent)} intervals"
        )
        share = 100 * float(np.mean(bent))
        record.figure(f"curvatures that cover, {4 * columns * rows} edges drawn", share, "%")


def _of_flat_fields(record: Recorder, draws: int) -> None:
    """Where nothing is tilted or bent, nothing must be found."""
    rng = np.random.default_rng(77)
    lens = replace(
        drawn_lens(rng), tangential_mm=0.0, sagittal_mm=0.0, tilt_x_mm=0.0, tilt_y_mm=0.0
    )
    clean, covered = clean_series(lens), []
    for _ in range(draws):
        found = measured(clean, rng)
        if found is not None and found.field is not None:
            covered += [
                _covers(value, truth) for name, value, truth in compared(lens, found)
                if not name.startswith(("best", "depth"))
            ]  # fmt: skip
    record.figure("intervals that hold 0, lens without any", 100 * float(np.mean(covered)), "%")
    still = [chart(lens, squares(lens, COLUMNS, ROWS), HALF_PX, TURN_DEG, 0.0)] * len(POSITIONS_MM)
    points = [0 if (found := measured(still, rng)) is None else len(found.points)
              for _ in range(max(draws // 2, 1))]  # fmt: skip
    share = 100 * float(np.mean(points)) / (4 * COLUMNS * ROWS)
    record.figure("edges with a best focus that does not exist", share, "%")


def _of_pupils(record: Recorder, draws: int) -> None:
    """Edges behind a perfect lens: the contrast through focus is Hopkins's, its best at 0."""
    record.say("\nperfect lens with defocus: best focus and depth of focus in waves")
    angles = (7.0, 97.0)
    worst = 0.0
    for number in F_NUMBERS:
        at_best = float(f_number(number).otf(np.array([STATED.freq_cy_per_px]), np.zeros(1))[0])
        stated = replace(STATED, contrast=round(0.4 * at_best, 3))
        half = 0.5 * _pupil_depth(number, 0.0, stated)
        waves_of = {f"{one}": round(one * half, 4) for one in SHARES}
        best, depth, true = [], [], []
        for seed in range(draws):
            edges: list[EdgeMeasurement] = []
            for number_of, (name, waves) in enumerate(waves_of.items()):
                images = edge_photographs(
                    f_number(number, waves), angles, 120, 100, 99 * seed + number_of
                )
                for angle, image in zip(angles, images, strict=True):
                    edges += [
                        # Both edges lie at the same place of one chart.
                        one.model_copy(update={"image": name})
                        for one in EdgeSelection().measured_in(
                            EdgeImage(name=f"{angle}", image_dn=image), "all-angles"
                        )
                    ]
            picture = Picture(width_px=120, height_px=120, pixel_pitch_um=None)
            found = through_focus(edges, waves_of, picture, stated, "focus")
            if found is None:
                raise ValueError("the series has a best focus")
            for one in found.points:
                if one.depth_mm is not None:
                    best.append(one.best_mm.value)
                    depth.append(one.depth_mm.value)
                    true.append(_pupil_depth(number, _normal(one), stated))
        ratio = 100 * (np.array(depth) / np.array(true) - 1)
        shift = 100 * np.array(best) / np.array(true)
        worst = max(worst, float(np.abs(np.median(ratio))))
        record.say(
            f"  f/{number:g}: depth {np.mean(true):.3f} waves, off by {np.median(ratio):+.2f} % "
            f"(largest {np.abs(ratio).max():.2f}); best focus off by {np.median(shift):+.2f} % "
            f"of it (largest {np.abs(shift).max():.2f}), {len(depth)} edges"
        )
    record.figure("depth of focus of a perfect lens, median error", worst, "%")


def _pupil_depth(number: float, normal: float, stated: StatedContrast) -> float:
    freq = np.array([stated.freq_cy_per_px])

    def above(waves: float) -> float:
        camera = f_number(number, waves)
        return float(camera.otf(cos(normal) * freq, sin(normal) * freq)[0]) - stated.contrast

    return 2 * float(brentq(above, 0.0, _MOST_WAVES))


@benchmark("numpy", "scipy", note="80 edges, 13 positions, SNR 100")
def main(record: Recorder) -> None:
    """Compare with closed forms."""
    lenses, draws = record.pick(8, 1), record.pick(6, 1)
    _of_lenses(record, 5, lenses, draws, "lenses looked at while it was made")
    _of_lenses(record, 2112, lenses, draws, "others, never looked at")
    _of_drawn(record, record.pick(100, 2))
    _of_flat_fields(record, record.pick(16, 1))
    _of_pupils(record, record.pick(4, 1))
