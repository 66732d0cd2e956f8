"""How sure d', the limits and the verdicts are: calibrated from pixels, held against closed forms.

Each run photographs edges (or a scene from two distances, with the scatter of the focus stated, as
two photographs do not tell it), calibrates, photographs a scene, computes a curve with its
interval, and judges pairs. The lens is a Gaussian, pixel included; every capture (of edges, of the
scene, of the pair) has a focus of its own, normal with a scatter of 0 to 0.15 px^2. The scene is a
Gaussian random field, whose d' is known in closed form for the pair's own two lenses
(``gaussian_scenes``, which shares nothing with ``analysis``).

Reported: the share of 95 % intervals of d', of the zoom limit and of the tilt limit that hold the
truth; of 1000 poses of random zoom, how many verdicts are wrong, and unsure near the threshold; the
time of a curve's interval beside the curve.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.dprime_coverage [--quick]
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import atan2, pi, sqrt
from time import perf_counter

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from analysis.detectability import (
    DetectabilityCurve,
    DetectionTask,
    ErrorSources,
    curves_of,
    curves_of_images,
    scene_sums,
)
from analysis.pose import ViewingCamera, decide, limits_of_curve
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.edges import white_noise
from benchmarks.truth.gaussian_scenes import GaussianScene, true_d_prime
from calibration.blind import calibrate_from_distances
from calibration.edges import EdgeImage
from calibration.errors import PairError
from calibration.psf import PsfCalibration, psf_of_images
from simulation.arrays import FloatArray
from standoff.library.detectability import known_errors

SCENE = GaussianScene()
PSF_PX2 = 0.64
NOISE_DN, CONTRAST_DN = 2.0, 12.0
ZOOMS = (1.0, 1.01, 1.1, 1.2, 1.3, 1.4, 1.57, 1.73, 1.93, 2.3, 2.8)
JUDGED = (1.2, 1.4, 1.57, 1.93)
SCATTERS_PX2 = (0.0, 0.05, 0.1, 0.15)
SNRS = (100.0, 30.0)
THRESHOLD = 1.6
CAMERA = ViewingCamera(focal_length_px=964.0, width_px=780, height_px=580)
EDGE_PX = 56
LEVELS_DN = (600.0, 3000.0)
_TRUE_ZOOMS = np.linspace(1.03, 2.75, 19)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Condition:
    """What a run is made of."""

    snr: float
    scatter_px2: float
    captures: int = 8
    photographs: int = 4
    is_two_distance: bool = False

    @property
    def name(self) -> str:
        """In words."""
        whence = ", from two distances" if self.is_two_distance else ""
        return f"SNR {self.snr:g}, focus scatter {self.scatter_px2:g} px^2{whence}"


def _edges_of(condition: _Condition, rng: np.random.Generator) -> Iterator[EdgeImage]:
    """Four edges of each capture, all with the capture's focus; a closed form."""
    noise_dn = (LEVELS_DN[1] - LEVELS_DN[0]) / condition.snr
    known = white_noise(noise_dn)
    at = np.arange(EDGE_PX) - (EDGE_PX - 1) / 2
    for capture in range(condition.captures):
        psf_px2 = PSF_PX2 + condition.scatter_px2 * rng.standard_normal()
        for turn in range(4):
            angle = turn * pi / 4 + rng.uniform(0.05, 0.4)
            away = at[None] * np.cos(angle) + at[:, None] * np.sin(angle) + rng.uniform(-0.5, 0.5)
            share = ndtr(away / sqrt(max(psf_px2, 0.05)))
            image = LEVELS_DN[0] + (LEVELS_DN[1] - LEVELS_DN[0]) * share
            yield EdgeImage(
                name=f"capture {capture} edge {turn}",
                image_dn=image + rng.normal(0.0, noise_dn, image.shape),
                capture=capture,
                noise=known,
            )


def _calibrated(
    condition: _Condition, rng: np.random.Generator
) -> tuple[PsfCalibration, ErrorSources]:
    """The PSF from pixels, and what is known of it."""
    if not condition.is_two_distance:
        psf = psf_of_images(_edges_of(condition, rng))
        return psf, known_errors(psf)
    waves = SCENE.waves(rng)
    noise_dn = 2 * sqrt(sum(SCENE.variances_dn2)) / condition.snr
    known = white_noise(noise_dn)
    pair = []
    for zoom, side_px in ((1.0, 300), (2.0, 158)):
        psf_px2 = PSF_PX2 + condition.scatter_px2 * rng.standard_normal()
        image = waves.photograph(side_px, zoom, max(psf_px2, 0.05))
        noisy = image + rng.normal(0.0, noise_dn, image.shape)
        pair.append(EdgeImage(name=f"zoom {zoom:g}", image_dn=noisy, noise=known))
    psf = calibrate_from_distances([pair])
    return psf, known_errors(psf, focus_scatter_px2=condition.scatter_px2)


def _focus_of_pair(condition: _Condition, rng: np.random.Generator) -> tuple[float, float]:
    """What focus adds to the variance of reference and follow-up."""
    reference, followup = (condition.scatter_px2 * rng.standard_normal(2)).tolist()
    return reference, followup


def _curve_of(
    condition: _Condition, psf: PsfCalibration, sources: ErrorSources, rng: np.random.Generator
) -> DetectabilityCurve:
    """The curve from photographs of the scene, each with its own focus."""
    scenes = [
        SCENE.photograph(300, PSF_PX2 + condition.scatter_px2 * rng.standard_normal(), rng)
        for _ in range(condition.photographs)
    ]
    task = _task_with(sources)
    return curves_of_images(scenes, psf.best_psf("psf"), task).curves[0]


def _task_with(sources: ErrorSources) -> DetectionTask:
    """One curve: model ``matched``, Hotelling's observer."""
    return DetectionTask(
        noises_dn=(NOISE_DN,),
        contrasts_dn=(CONTRAST_DN,),
        models=("matched",),
        observers=("hotelling",),
        zooms=ZOOMS,
        sources=sources,
    )


def _truth(zoom: float, focus_px2: tuple[float, float]) -> float:
    """The pair's d' in closed form."""
    return true_d_prime(SCENE, PSF_PX2, zoom, NOISE_DN, CONTRAST_DN, focus_px2)


def _true_zoom_limit(focus_px2: tuple[float, float]) -> float | None:
    """Zoom at which the pair's d' falls to the threshold; None beyond what is looked at."""
    values = np.log([_truth(zoom, focus_px2) / THRESHOLD for zoom in _TRUE_ZOOMS.tolist()])
    below = np.flatnonzero(values < 0)
    if below.size == 0 or below[0] == 0:
        return None
    k = int(below[0])
    return float(
        brentq(
            lambda zoom: float(np.interp(zoom, _TRUE_ZOOMS, values)),
            _TRUE_ZOOMS[k - 1],
            _TRUE_ZOOMS[k],
        )
    )


def _tilted_zoom(tilt_deg: float) -> float:
    """Worst local zoom of a camera that tilts about the point it looks at, by own ray tracing.

    Rays through a dense grid of pixels meet the plane; the stretch of the reference's pixels is
    taken by differences, where the reference sees the place too. Leans along the frame's axes and
    its diagonal, the worst of which counts.
    """
    tilt, focal_px = np.deg2rad(tilt_deg), CAMERA.focal_length_px
    half = (CAMERA.width_px - 1) / 2, (CAMERA.height_px - 1) / 2
    x, y = np.meshgrid(np.linspace(-half[0], half[0], 521), np.linspace(-half[1], half[1], 387))
    worst = 0.0
    for lean in (0.0, atan2(CAMERA.height_px, CAMERA.width_px), pi / 2):
        cos, sin = np.cos(lean), np.sin(lean)

        def met(x: FloatArray, y: FloatArray, cos: float = cos, sin: float = sin) -> FloatArray:
            """Reference pixels at which rays meet the plane."""
            along, across = cos * x + sin * y, cos * y - sin * x
            # The plane through (0, 0, f), leaning towards the first axis.
            depth = focal_px / (1 - np.tan(tilt) * along / focal_px) / focal_px
            first, second = depth * along / np.cos(tilt), depth * across
            return np.stack([cos * first - sin * second, sin * first + cos * second])

        place = met(x, y)
        by_x, by_y = met(x + 0.5, y) - met(x - 0.5, y), met(x, y + 0.5) - met(x, y - 0.5)
        square = np.sum(by_x**2 + by_y**2, axis=0)
        area = by_x[0] * by_y[1] - by_x[1] * by_y[0]
        stretch = np.sqrt((square + np.sqrt(np.maximum(square**2 - 4 * area**2, 0.0))) / 2)
        is_seen = (np.abs(place[0]) <= half[0] + 0.5) & (np.abs(place[1]) <= half[1] + 0.5)
        worst = max(worst, float(stretch[is_seen].max()))
    return worst


def _run(condition: _Condition, seed: int, tally: Counter[str]) -> None:
    """One calibration, one curve, and pairs that are judged by it."""
    rng = np.random.default_rng([seed, round(condition.snr), round(1000 * condition.scatter_px2)])
    try:
        psf, sources = _calibrated(condition, rng)
    except PairError:  # the far photograph was the sharper one: refused, and no interval
        tally["refused"] += 1
        return
    curve = _curve_of(condition, psf, sources, rng)
    focus_px2 = _focus_of_pair(condition, rng)
    for zoom in JUDGED:
        at = curve.zoom.index(zoom)
        tally[f"d' {zoom:g}"] += (
            curve.dprime_low[at] <= _truth(zoom, focus_px2) <= curve.dprime_high[at]
        )
    limit = _true_zoom_limit(focus_px2)
    if limit is not None:
        tally["limits"] += 1
        found = limits_of_curve(curve, THRESHOLD, CAMERA)
        low, high = found.zoom_interval_95
        tally["zoom limit"] += (low or 0.0) <= limit <= (high or np.inf)
    tally["runs"] += 1
    for _ in range(2):
        _judge(curve, condition, rng, tally)


def _judge(
    curve: DetectabilityCurve, condition: _Condition, rng: np.random.Generator, tally: Counter[str]
) -> None:
    """A pose near the threshold, by the curve, and by the pair's own d'."""
    zoom = float(rng.uniform(1.25, 1.75))
    focus_px2 = _focus_of_pair(condition, rng)
    true = _truth(round(zoom, 2), focus_px2)
    zoom = round(zoom, 2)
    verdict = decide(curve, zoom, float(curve.d_prime_at(zoom)), THRESHOLD).verdict
    tally["poses"] += 1
    tally[verdict] += 1
    tally["wrong go"] += verdict == "go" and true < THRESHOLD
    tally["wrong no go"] += verdict == "no go" and true >= THRESHOLD
    if abs(true / THRESHOLD - 1) < 0.05:
        tally["near"] += 1
        tally["near unsure"] += verdict == "unsure"


def _coverage(record: Recorder, runs: int) -> None:
    """All conditions; the shares of each, and of all together."""
    for is_two_distance in (False, True):
        everything: Counter[str] = Counter()
        for snr, scatter_px2 in product(SNRS, SCATTERS_PX2):
            condition = _Condition(
                snr=snr, scatter_px2=scatter_px2, is_two_distance=is_two_distance
            )
            everything += _repeated(record, condition.name, condition, runs)
        _say(record, "all from two distances" if is_two_distance else "all from edges", everything)
    locked = _Condition(snr=100.0, scatter_px2=0.002, captures=16, photographs=24)
    _repeated(record, "a focus that is locked, 24 photographs", locked, runs)


def _repeated(record: Recorder, name: str, condition: _Condition, runs: int) -> Counter[str]:
    """One condition, again and again; its shares are printed."""
    tally: Counter[str] = Counter()
    for seed in range(runs):
        _run(condition, seed, tally)
    _say(record, name, tally)
    return tally


def _say(record: Recorder, name: str, tally: Counter[str]) -> None:
    """Print the shares, and keep them."""
    shares = {f"d' at zoom {zoom:g}": tally[f"d' {zoom:g}"] / tally["runs"] for zoom in JUDGED}
    shares["zoom limit"] = tally["zoom limit"] / max(tally["limits"], 1)
    shares["go that is wrong"] = tally["wrong go"] / max(tally["go"], 1)
    shares["no go that is wrong"] = tally["wrong no go"] / max(tally["no go"], 1)
    shares["unsure"] = tally["unsure"] / tally["poses"]
    shares["unsure within 5 % of the threshold"] = tally["near unsure"] / max(tally["near"], 1)
    text = ", ".join(f"{what} {100 * share:.1f} %" for what, share in shares.items())
    record.say(f"{name}, {tally['runs']} runs, {tally['poses']} poses: {text}")
    for what, share in shares.items():
        record.figure(f"{what}, {name}", 100 * share, "%")


def _tilts(record: Recorder) -> None:
    """The tilt limit is the zoom limit seen through the camera: by an own geometry."""
    errors = []
    curve = DetectabilityCurve.model_validate(
        {
            **{"model": "matched", "observer": "hotelling", "noise_dn": 2.0, "contrast_dn": 12.0},
            **{"signal_sigma_px": 2.0, "zoom": [1.0, 2.0], "dprime": [4.0, 1.0]},
            **{"dprime_low": [3.0, 0.8], "dprime_high": [5.0, 1.2], "auc": [0.9, 0.8]},
        }
    )
    for threshold in (1.5, 2.0, 2.5, 3.0):
        found = limits_of_curve(curve, threshold, CAMERA)
        assert found.tilt_deg is not None
        own = brentq(lambda t, zoom=found.zoom: _tilted_zoom(t) - zoom, 0.5, 40.0)
        errors.append(abs(own - found.tilt_deg))
    record.say(f"tilt limits beside an own geometry: within {max(errors):.3f} degrees")
    record.figure("tilt limit's largest error", max(errors), "degrees")


def _cost(record: Recorder) -> None:
    """Time of the curves with and without what their intervals need, as a ratio."""
    rng = np.random.default_rng(0)
    scenes = [SCENE.photograph(300, PSF_PX2, rng) for _ in range(2)]
    psf = psf_of_images(_edges_of(_Condition(snr=100.0, scatter_px2=0.0), rng)).best_psf("psf")
    task = DetectionTask()
    plan = task.plan(psf, 2)
    sums = [scene_sums(scene, plan) for scene in scenes]

    def seconds(some: list[FloatArray]) -> float:
        begin = perf_counter()
        curves_of(
            lambda model: [sums[0].artefact(model, zoom) for zoom in range(len(task.zooms))],
            1,
            plan,
            task,
            some=some,
        )
        return perf_counter() - begin

    seconds(scenes)
    without, whole = min(seconds([]) for _ in range(2)), min(seconds(scenes) for _ in range(2))
    record.say(
        f"curves with intervals of all sources take {whole / without:.2f} of the time without"
    )
    record.figure("time of curves with their intervals, over without", whole / without, "times")


@benchmark("numpy", "scipy")
def main(record: Recorder) -> None:
    _tilts(record)
    _cost(record)
    _coverage(record, 2 if record.is_quick else 63)
