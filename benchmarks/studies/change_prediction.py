"""The limit that ``detectability --observer changes`` predicts beside the one that a pair shows.

Sixty pairs of the simulated bench, and sixty of flat scenes: two lenses, three noises, ten poses of
zoom 1 to 2 and tilt to 15 degrees, rendered by ``pair_photographs``, which shares nothing with
``simulation``. The prediction is made from the reference alone (``--reference-zoom 1``), a PSF that
is wrong by 2 %, and the noise; it is held against the median of the pair's own map of the limit,
aligned as the command does. The linear observers, turned round in the same way, are the peers.

``Staged``: pairs whose follow-up is out of focus, in half the light, given a wrong homography,
compressed or aliased. How often what the pair lost is named rightly, and named first; pairs that
lost no more than 15 % are told apart, as there is nothing to name.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.change_prediction [--quick]
"""

from dataclasses import dataclass, field, replace
from math import log
from time import perf_counter

import numpy as np

from analysis.changes import (
    ChangeOptions,
    ChangeSummary,
    changes_between,
    height_for,
)
from analysis.choices import OBSERVERS, Observer
from analysis.detectability import (
    DetectabilityCurves,
    DetectionTask,
    GaussianSignal,
    curves_of_images,
    expected_limits,
)
from analysis.detection_limits import PredictedLimit
from benchmarks.harness import Recorder, benchmark
from benchmarks.studies.capture_model import true_psf
from benchmarks.studies.changes import TARGETS, bench_of
from benchmarks.truth.lenses import Camera, f_number, gaussian
from benchmarks.truth.pairs import Development, PairPose, pair_of, scene
from calibration.errors import RegistrationError
from calibration.registration import DistortedPose
from simulation import GaussianPsf, LensOtf, MeasuredPsf, Psf
from simulation.arrays import FloatArray
from tests.analysis.changed_scenes import (
    bench_noise,
    bench_pair,
    bench_psf,
    far_pose,
    with_noise_of,
)

FRAME = (290, 390)
SCENES = {"texture": 25.0, "retina": 13.0, "lesion": 15.0, "mondrian": 45.0, "text": 40.0}
NOISES_DN = (0.6, 1.2, 2.4)
TILTS_DEG = (0.0, 15.0, 5.0, 10.0, 2.0, 12.0, 7.0, 0.0, 4.0, 9.0)
POSES = 10
ZOOMS = (1.0, 1.01, 1.1, 1.25, 1.5, 1.75, 2.0)
SIGNAL_PX = 2.0
PSF_ERR = 0.02
ROUND, SHARP, ALIASING = gaussian(0.9, has_pixel=False), f_number(8.0), f_number(2.8)
BENCH_POSES: tuple[tuple[float, dict[str, float]], ...] = (
    (1.1, {}),
    (1.3, {"tilt_x_deg": 8.0}),
    (1.5, {"tilt_x_deg": 4.0, "roll_deg": 3.0, "offset_x_mm": 3.0}),
    (1.8, {"tilt_y_deg": 14.0}),
    (2.0, {}),
)
BENCH_FRAMES = (1, 10, 50)
SHARP_SIGMA_PX = 0.42
"""Of the Gaussian nearest to f/8 over pixels; registration alone uses it."""

PLAIN = Development()
SOURCES = ("focus", "light", "registration", "texture")


def _calibrated(camera: Camera) -> Psf:
    """The camera's PSF, 2 % too wide."""
    if not camera.has_pixel:
        return GaussianPsf(sigma_px=camera.sigma_px * (1 + PSF_ERR))
    psf = true_psf(camera, GaussianPsf(sigma_px=SHARP_SIGMA_PX))
    assert isinstance(psf, MeasuredPsf)
    xx, xy, yy = psf.lens.cut_off_period_px
    wider = tuple(value * (1 + PSF_ERR) for value in (xx, xy, yy))
    return MeasuredPsf(
        lens=LensOtf(cut_off_period_px=(wider[0], wider[1], wider[2])), gaussian=psf.gaussian
    )


def _predicted(
    reference: FloatArray, psf: Psf, noise_dn: float, observers: tuple[Observer, ...]
) -> DetectabilityCurves:
    task = DetectionTask(
        signal=GaussianSignal(sigma_px=SIGNAL_PX),
        contrasts_dn=(10.0,),
        noises_dn=(noise_dn,),
        zooms=ZOOMS,
        models=("matched",),
        observers=observers,
        reference_zoom=1.0,
    )
    return curves_of_images([reference], psf, task)


def _met(
    reference: FloatArray,
    followup: FloatArray,
    psf: Psf,
    curves: DetectabilityCurves,
    pose: DistortedPose | None = None,
) -> tuple[ChangeSummary, PredictedLimit]:
    """Compare the pair, with the limit that was predicted."""
    options = ChangeOptions(pose=pose, expected=expected_limits(curves.curves[0]))
    summary = changes_between(reference, followup, psf, options).summary
    assert summary.detection_limit is not None
    assert summary.detection_limit.predicted is not None
    return summary, summary.detection_limit.predicted


@dataclass(kw_only=True)
class _Ratios:
    """Logarithms of shown over predicted limits, with what they are of."""

    logs: list[float] = field(default_factory=list)
    kinds: list[dict[str, float | str]] = field(default_factory=list)
    peers: dict[str, list[float]] = field(default_factory=lambda: {o: [] for o in OBSERVERS})
    seconds: dict[str, float] = field(default_factory=lambda: {"changes": 0.0, "linear": 0.0})

    def part(self, key: str, value: float | str) -> FloatArray:
        """Those of one kind."""
        return np.array(
            [one for one, kind in zip(self.logs, self.kinds, strict=True) if kind[key] == value]
        )


def _judge_pair(ratios: _Ratios, camera: Camera, number: int, noises: tuple[float, ...]) -> None:
    """One pose of one lens in every noise."""
    lens = int(camera is SHARP)
    name = list(SCENES)[(number + lens) % len(SCENES)]
    pose = PairPose(
        zoom=float(np.linspace(1, 2, POSES)[number]),
        tilt_deg=TILTS_DEG[(number + 3 * lens) % POSES],
        bearing_deg=37.0 * number + 90.0 * lens,
        turn_deg=3 * float(np.sin(number + lens)),
        shift=(0.01 * float(np.cos(3 * number)), 0.01 * float(np.sin(5 * number))),
    )
    seed = 100 * lens + number
    made = pair_of(
        scene(name, FRAME, seed, contrast_dn=SCENES[name]), FRAME, pose, (camera, camera)
    )
    psf = _calibrated(camera)
    for place, noise_dn in enumerate(noises):
        developed = Development(noise_dn=noise_dn)
        reference, followup = (
            developed.of(levels, 1000 + 20 * seed + 2 * place + turn)
            for turn, levels in enumerate((made.reference_dn, made.followup_dn))
        )
        started = perf_counter()
        own = _predicted(reference, psf, noise_dn, ("changes",))
        half = perf_counter()
        linear = _predicted(reference, psf, noise_dn, OBSERVERS)
        ratios.seconds["changes"] += half - started
        ratios.seconds["linear"] += perf_counter() - half
        summary, limit = _met(reference, followup, psf, own)
        ratios.logs.append(log(limit.ratio))
        tilt = "to 5 deg" if pose.tilt_deg <= 5 else "to 15 deg"
        ratios.kinds.append({"lens": camera.name, "noise": noise_dn, "tilt": tilt, "scene": name})
        spot = own.curves[0]
        zoom = float(np.clip(summary.zoom, 1, ZOOMS[-1]))
        seen = float(np.interp(zoom, spot.zoom, spot.seen_dn or []))
        height = height_for(0.95, summary.threshold_sd)
        for curve in linear.curves:
            said = height * seen / float(curve.d_prime_at(zoom))
            ratios.peers[curve.observer].append(log(limit.shown_dn / said))


def _judge_bench(record: Recorder, targets: tuple[str, ...], turns: int) -> None:
    """Pairs of the simulated bench, whose noise depends on the level, by its mean."""
    truth = bench_of(0.0)
    psf, logs, seed = bench_psf(truth), [], 0
    for target in targets:
        for zoom, pose in BENCH_POSES[:turns]:
            clean = bench_pair(
                truth,
                target,
                far_pose(truth, zoom, **pose),
                contrast=0.0,
                sigma_mm=0.8,
                pitch_mm=12.5,
                seed=seed,
                frames_averaged=None,
            )
            for frames in BENCH_FRAMES:
                seed += 1
                pair = with_noise_of(truth, clean, seed=seed, frames_averaged=frames)
                variance_dn2 = bench_noise(truth, frames).variance_dn2(pair.reference)
                noise_dn = float(np.sqrt(variance_dn2.mean()))
                curves = _predicted(pair.reference, psf, noise_dn, ("changes",))
                try:
                    summary, limit = _met(pair.reference, pair.followup, psf, curves)
                except RegistrationError as error:
                    # Beyond its border the bench's target goes on as its own mirror image.
                    record.say(f"    {target} {zoom} {frames}: refused, {error}")
                    continue
                logs.append(log(limit.ratio))
                if abs(logs[-1]) > log(1.4):
                    record.say(
                        f"    {target} {zoom} {frames}: {limit.ratio:.2f}; {summary.warnings}"
                    )
    apart = np.abs(logs)
    median, most = float(np.median(apart)), float(np.quantile(apart, 0.9))
    record.say(f"{len(logs)} pairs of the simulated bench: {median:.3f} {most:.3f}")
    record.figure("limits apart on the simulated bench, median", median, "")
    record.figure("limits apart on the simulated bench, 90 %", most, "")


def _say_agreement(record: Recorder, ratios: _Ratios) -> None:
    def figures(logs: FloatArray) -> tuple[float, float]:
        return float(np.median(np.abs(logs))), float(np.quantile(np.abs(logs), 0.9))

    median, most = figures(np.array(ratios.logs))
    peers = {name: figures(np.array(logs)) for name, logs in ratios.peers.items()}
    best = min(peers, key=lambda name: peers[name][0])
    record.say(f"{len(ratios.logs)} pairs, |ln(shown / predicted)|, median and 90 % quantile:")
    record.say(f"  changes    {median:.3f} {most:.3f}")
    for name, (half, high) in peers.items():
        record.say(f"  {name:10s} {half:.3f} {high:.3f}")
    for key in ("lens", "noise", "tilt", "scene"):
        for value in dict.fromkeys(kind[key] for kind in ratios.kinds):
            half, high = figures(ratios.part(key, value))
            record.say(f"    {key} {value}: {half:.3f} {high:.3f}")
    record.figure("limits apart, median", median, "", best, peers[best][0])
    record.figure("limits apart, 90 %", most, "", best, peers[best][1])
    each = len(ratios.logs) * len(ZOOMS)
    record.figure(
        "prediction of one zoom of one photograph",
        1000 * ratios.seconds["changes"] / each,
        "ms",
        "the linear observers",
        1000 * ratios.seconds["linear"] / each,
    )
    record.say(
        f"a zoom of a photograph: {1000 * ratios.seconds['changes'] / each:.0f} ms, the three "
        f"linear observers {1000 * ratios.seconds['linear'] / each:.0f} ms"
    )


@dataclass(frozen=True, kw_only=True)
class _Stage:
    """What is done to the follow-up, and what it should be called."""

    name: str
    source: str
    cameras: tuple[Camera, Camera] = (ROUND, ROUND)
    before: Development = PLAIN
    after: Development = PLAIN
    noise: float = 1.0
    skew: float = 0.0


STAGES = (
    _Stage(
        name="softer, 0.9 to 1.7 px",
        source="focus",
        cameras=(ROUND, gaussian(1.7, has_pixel=False)),
    ),
    _Stage(
        name="softer, 0.9 to 2 px", source="focus", cameras=(ROUND, gaussian(2.0, has_pixel=False))
    ),
    _Stage(name="half the light", source="light", after=Development(gain=0.5)),
    _Stage(name="twice the noise", source="light", noise=2.0),
    _Stage(name="homography, 1.2 px at the rim", source="registration", skew=1.0),
    _Stage(name="homography, 3 px at the rim", source="registration", skew=2.5),
    _Stage(
        name="JPEG 70",
        source="texture",
        before=Development(jpeg_quality=70),
        after=Development(jpeg_quality=70),
    ),
    _Stage(
        name="JPEG 85",
        source="texture",
        before=Development(jpeg_quality=85),
        after=Development(jpeg_quality=85),
    ),
    _Stage(name="f/2.8, aliasing", source="texture", cameras=(ALIASING, ALIASING), noise=0.4),
)
STAGED = (
    ("texture", 1.3, 4.0, 1.2),
    ("lesion", 1.6, 3.0, 0.8),
    ("mondrian", 1.2, 8.0, 1.0),
    ("retina", 1.8, 2.0, 1.2),
    ("text", 1.45, 6.0, 1.0),
)
"""Scenes with zoom, tilt and noise."""


def _skewed(matrix: FloatArray, amount: float) -> FloatArray:
    """A wrong homography about the middle of the frame."""
    middle = np.eye(3)
    middle[:2, 2] = -(FRAME[1] - 1) / 2, -(FRAME[0] - 1) / 2
    wrong = np.eye(3) + amount * np.array(
        [[0.006, 0.004, 0.2], [0.0, -0.004, 0.1], [2e-5, 1e-5, 0.0]]
    )
    return np.asarray(matrix @ np.linalg.inv(middle) @ wrong @ middle)


def _stage(kind: _Stage, number: int, seed: int) -> PredictedLimit:
    """Predict from a sound reference, then compare the staged pair."""
    name, zoom, tilt_deg, noise_dn = STAGED[number]
    pose = PairPose(zoom=zoom, tilt_deg=tilt_deg, bearing_deg=50.0 * number, turn_deg=2.0)
    made = pair_of(
        scene(name, FRAME, seed + number, contrast_dn=SCENES[name]), FRAME, pose, kind.cameras
    )
    aliases = kind.cameras[0] is ALIASING
    psf = GaussianPsf(sigma_px=0.36) if aliases else _calibrated(ROUND)
    assumed_dn = noise_dn * kind.noise if aliases else noise_dn
    noise_dn *= kind.noise
    reference = replace(kind.before, noise_dn=noise_dn).of(
        made.reference_dn, 2 * seed + 20 * number
    )
    followup = replace(kind.after, noise_dn=noise_dn).of(
        made.followup_dn, 2 * seed + 20 * number + 1
    )
    sound = Development(noise_dn=assumed_dn).of(made.reference_dn, 2 * seed + 20 * number)
    given = None
    if kind.skew:
        matrix = _skewed(made.matrix, kind.skew)
        given = DistortedPose(matrix=matrix, k1=0.0, reference_shape=FRAME, followup_shape=FRAME)
    curves = _predicted(sound, psf, assumed_dn, ("changes",))
    return _met(reference, followup, psf, curves, given)[1]


def _named(limit: PredictedLimit) -> list[str]:
    """Sources that a pair names, in its order."""
    return [line.rpartition("(")[2].rstrip(")") for line in limit.lost_to]


def _judge_stages(record: Recorder, rounds: int, scenes: int) -> None:
    right = first = lost = 0
    for kind in STAGES:
        own = []
        for turn in range(rounds):
            for number in range(scenes):
                limit = _stage(kind, number, 500 + 100 * turn)
                own.append((limit.ratio, _named(limit)))
        counted = [names for ratio, names in own if ratio > 1.15]
        lost += len(counted)
        right += sum(kind.source in names for names in counted)
        first += sum(names[:1] == [kind.source] for names in counted)
        others = {s: sum(s in names for names in counted) for s in SOURCES if s != kind.source}
        ratios = " ".join(f"{ratio:.2f}" for ratio, _ in own)
        beside = ", ".join(f"{source} {count}" for source, count in others.items() if count)
        record.say(
            f"  {kind.name:30s} {kind.source:12s} named {sum(kind.source in n for n in counted)}, "
            f"first {sum(n[:1] == [kind.source] for n in counted)} of {len(counted)} with a loss; "
            f"also named: {beside or 'none'}; shown over predicted {ratios}"
        )
    record.say(f"staged: {right} of {lost} named rightly, {first} first")
    record.figure("staged cases whose source is not named", 1 - right / max(lost, 1), "")
    record.figure("staged cases whose source is not named first", 1 - first / max(lost, 1), "")


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder) -> None:
    ratios = _Ratios()
    for camera in (ROUND, SHARP):
        for number in record.pick(range(POSES), range(3, 4)):
            _judge_pair(ratios, camera, number, record.pick(NOISES_DN, NOISES_DN[1:2]))
    _say_agreement(record, ratios)
    _judge_bench(record, record.pick(TARGETS, TARGETS[:1]), record.pick(len(BENCH_POSES), 1))
    _judge_stages(record, record.pick(2, 1), record.pick(len(STAGED), 1))
