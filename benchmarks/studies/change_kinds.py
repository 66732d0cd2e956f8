"""Changes between two photographs by what differs between them besides: lens, focus, camera, files.

For each kind of pair: pixels flagged a frame without a change at stated rates; spots of 6 DN and a
width of 1.5 px found, of those that both photographs show; false pixels at equal true positives,
beside the two photographs' plain difference in the same light fit and smoothing. Each pair is
compared in both directions and aligned as the command does; ``--true-pose`` gives the comparison's
own score.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.change_kinds [--quick] [--noise DN] [--kind K]
        [--seed N] [--true-pose]
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from analysis.changes import ChangeOptions, ChangeResult, changes_between, significance_threshold
from benchmarks.harness import Recorder, benchmark
from benchmarks.scoring import PixelScores, changed_and_clear
from benchmarks.truth.lenses import Camera, f_number, gaussian
from benchmarks.truth.pairs import Development, Pair, PairPose, pair_of, scene, seen_spot
from calibration.registration import DistortedPose
from simulation import GaussianPsf
from simulation.arrays import FloatArray

FRAME = (290, 390)
STATED = (0.05, 1.0, 10.0)
TPR = (0.5, 0.8, 0.9)
DRAWS = 4
SPOT_DN, SPOT_PX = 6.0, 1.5
SPOTS_ACROSS, SPOTS_DOWN = 6, 4

POSES = (
    PairPose(zoom=1.0, turn_deg=2.0, shift=(0.02, -0.01)),
    PairPose(zoom=1.3, turn_deg=-3.0, shift=(-0.01, 0.02)),
    PairPose(zoom=1.5, tilt_deg=5.0, bearing_deg=30.0, turn_deg=4.0),
    PairPose(zoom=2.0, turn_deg=1.0, shift=(0.01, 0.01)),
)
SCENES = (("texture", 25.0), ("lesion", 15.0), ("mondrian", 45.0), ("text", 40.0), ("retina", 13.0))
"""Names and standard deviations in DN."""


def _round(sigma_px: float) -> Camera:
    return gaussian(sigma_px, has_pixel=False)


@dataclass(frozen=True, kw_only=True)
class _Kind:
    """A kind of pairs.

    Cameras and rough width of the PSF are of reference and follow-up; developments are what they
    are made into, the noise comes on top. ``psf_px`` is what the comparison is told, None for
    nothing.
    """

    name: str
    cameras: tuple[Camera, Camera] = (_round(0.9), _round(0.9))
    blur_px: float = 0.9
    developments: tuple[Development, Development] = (Development(), Development())
    psf_px: float | None = None
    poses: tuple[PairPose, ...] = POSES
    scenes: tuple[tuple[str, float], ...] = SCENES

    @property
    def psf(self) -> GaussianPsf | None:
        """PSF that the comparison is told."""
        if self.psf_px is None:
            return None
        return GaussianPsf(sigma_x_px=self.psf_px, sigma_y_px=self.psf_px)


def _airy(number: float) -> _Kind:
    lens = f_number(number)
    return _Kind(
        name=f"f/{number:g}, rectangles",
        cameras=(lens, lens),
        blur_px=0.6,
        scenes=(("mondrian", 45.0), ("mondrian", 25.0)),
    )


def _focus(before_px: float, after_px: float) -> _Kind:
    return _Kind(
        name=f"{before_px:.2g} to {after_px:.2g} px",
        cameras=(_round(before_px), _round(after_px)),
        blur_px=after_px,
    )


def _developed(name: str, **how: object) -> _Kind:
    made = replace(Development(), **how)  # type: ignore[arg-type]  # fields by name
    return _Kind(name=name, developments=(made, made))


KINDS = (
    _Kind(name="one camera"),
    _Kind(name="with its PSF", psf_px=0.9),
    _Kind(name="PSF 20 % too wide", psf_px=1.08),
    _Kind(name="PSF 20 % too narrow", psf_px=0.72),
    _airy(4.0),
    _airy(5.6),
    _airy(8.0),
    _developed("8-bit JPEG 90", jpeg_quality=90),
    _developed("sharpened JPEG", jpeg_quality=90, sharpening=(0.8, 1.0)),
    *(_focus(0.9, float(np.sqrt(0.81 + extra))) for extra in (0.3, 0.6, 1.0)),
    _focus(0.9, 0.55),
    _focus(1.3, 0.5),
    _focus(1.8, 0.5),
    _Kind(
        name="other camera, gamma",
        cameras=(_round(0.6), _round(0.9)),
        developments=(Development(), Development(gain=1.15, gamma=0.45)),
    ),
    _Kind(
        name="distortion 1 %",
        poses=tuple(replace(pose, distortion_k1=k1) for pose in POSES[1:3] for k1 in (-0.01, 0.01)),
    ),
)


@dataclass(kw_only=True)
class _Score:
    """Sums over the pairs of a kind."""

    flagged: list[list[int]] = field(default_factory=list)
    spots: list[bool] = field(default_factory=list)
    own: PixelScores = field(default_factory=PixelScores)
    plain: PixelScores = field(default_factory=PixelScores)


def _pairs(kind: _Kind, seed: int) -> Iterator[tuple[Pair, Pair, FloatArray]]:
    """A pair without a change, the same with spots, and where those are, ``(x, y)``."""
    for number, pose in enumerate(kind.poses):
        for place, (name, contrast_dn) in enumerate(kind.scenes):
            at = 1000 * seed + 20 * number + place
            flat = scene(name, FRAME, at, contrast_dn=contrast_dn)
            rng = np.random.default_rng(at)
            x, y = np.meshgrid(
                np.linspace(45, FRAME[1] - 45, SPOTS_ACROSS),
                np.linspace(45, FRAME[0] - 45, SPOTS_DOWN),
            )
            where = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-12, 12, (x.size, 2))
            spots = tuple(
                seen_spot(
                    pose,
                    FRAME,
                    (float(x_px), float(y_px)),
                    sigma_px=SPOT_PX,
                    amplitude_dn=SPOT_DN * (1 if index % 2 else -1),
                    blur_px=kind.blur_px,
                )
                for index, (x_px, y_px) in enumerate(where)
            )
            yield (
                pair_of(flat, FRAME, pose, kind.cameras),
                pair_of(flat, FRAME, pose, kind.cameras, spots),
                where,
            )


@dataclass(frozen=True, kw_only=True)
class _Study:
    """How each kind is judged: noise of a photograph, pairs of noise a scene, seed, alignment."""

    noise_dn: float
    draws: int
    seed: int
    is_aligned: bool


def _scored(
    kind: _Kind, made: list[tuple[Pair, Pair, FloatArray]], study: _Study, *, is_swapped: bool
) -> _Score:
    """Compare pairs of a kind; swapped, the spots are in the earlier photograph."""
    score = _Score()
    before, after = (replace(how, noise_dn=study.noise_dn) for how in kind.developments)
    for number, (unchanged, changed, where) in enumerate(made):
        first = 1000 * study.seed + 100 * number  # noise of its own for each pair
        pose = unchanged.pose.known(FRAME)

        def found(pair: Pair, draw: int, pose: DistortedPose = pose) -> ChangeResult:
            reference, followup = pair.developed(before, after, draw)
            known = None if study.is_aligned else pose
            if is_swapped:
                options = ChangeOptions(pose=None if known is None else known.inverse())
                return changes_between(followup, reference, kind.psf, options)
            return changes_between(reference, followup, kind.psf, ChangeOptions(pose=known))

        for draw in range(study.draws):
            result = found(unchanged, first + draw)
            size = np.abs(result.significance[result.valid])
            score.flagged.append(
                [
                    int(np.sum(size > significance_threshold(r / size.size, result.filter_widths)))
                    for r in STATED
                ]
            )
        result = found(changed, first + study.draws)
        change = np.abs(changed.followup_dn - unchanged.followup_dn)
        _add_spots(score, result, change, where, pose if is_swapped else None)
    return score


def _add_spots(
    score: _Score,
    result: ChangeResult,
    change: FloatArray,
    where: FloatArray,
    pose: DistortedPose | None,
) -> None:
    """Add what was found of spots; ``pose`` takes them to the photograph that was compared."""
    size = np.abs(result.significance)
    x, y = where.T
    if pose is not None:
        y, x = pose.to_reference_px(y, x)
        rows, cols = np.indices(FRAME).astype(np.float64)
        back_y, back_x = pose.to_followup_px(rows, cols)
        row = np.clip(np.rint(back_y), 0, FRAME[0] - 1).astype(int)
        col = np.clip(np.rint(back_x), 0, FRAME[1] - 1).astype(int)
        change = change[row, col]
    for x_px, y_px in zip(x, y, strict=True):
        near = np.hypot(*np.subtract(np.indices(FRAME), [[[y_px]], [[x_px]]])) < 3
        if result.valid[near].all() and near.any():
            score.spots.append(bool((size[near] > result.summary.threshold_sd).any()))
    core, clear = changed_and_clear(change, result.valid)
    if core.any():
        score.own.add(size, core, clear)
        score.plain.add(np.abs(result.plain_difference_dn), core, clear)


@benchmark("numpy", "scipy", "numba")
def main(
    record: Recorder,
    *,
    noise: Annotated[float, "noise in DN"] = 1.2,
    kind: Annotated[str | None, "only kinds with this in their name"] = None,
    seed: Annotated[int, "of scenes and noise"] = 7,
    true_pose: Annotated[bool, "do not align"] = False,
) -> None:
    chosen = [scenery for scenery in KINDS if kind is None or kind in scenery.name]
    record.say(f"noise {noise:g} DN; false pixels a frame beside the plain difference's")
    for scenery in chosen:
        used = record.pick(
            scenery, replace(scenery, poses=scenery.poses[:2], scenes=scenery.scenes[:2])
        )
        study = _Study(
            noise_dn=noise,
            draws=record.pick(DRAWS, 1),
            seed=seed,
            is_aligned=not true_pose,
        )
        made = list(_pairs(used, seed))
        for is_swapped in (False, True):
            score = _scored(used, made, study, is_swapped=is_swapped)
            name = f"{scenery.name}{', swapped' if is_swapped else ''}"
            flagged = np.mean(score.flagged, axis=0)
            false = list(
                zip(score.own.false_a_frame(TPR), score.plain.false_a_frame(TPR), strict=True)
            )
            shown = "  ".join(f"{own:.1f} ({plain:.0f})" for own, plain in false)
            record.say(
                f"{name:30s} flagged {' '.join(f'{mean:6.2f}' for mean in flagged)} of "
                f"{len(score.flagged):3d} frames   found {sum(score.spots):4d} of "
                f"{len(score.spots):4d}   false at 50/80/90 %: {shown}"
            )
            for rate, mean in zip(STATED, flagged, strict=True):
                record.figure(f"{name}: flagged a frame, stated {rate:g}", float(mean), "px")
            record.figure(f"{name}: spots found", 100 * float(np.mean(score.spots)), "%")
            for rate, (own, plain) in zip(TPR, false, strict=True):
                record.figure(
                    f"{name}: false pixels a frame at {100 * rate:.0f} % true positives",
                    own,
                    "px",
                    "the plain difference",
                    plain,
                )
