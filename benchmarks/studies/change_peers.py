"""Changes beside other detectors: false pixels at equal true positives, by kind of pair.

Scenes are photographed twice, with 24 spots of 6 DN and 1.5 px in the second photograph. Peers:
SFFT and ZOGY from astronomy, IR-MAD from remote sensing, a map of SSIM, and the absolute difference
after an alignment by SIFT and MAGSAC. SFFT and ProperImage need an environment of their own:

    python -m venv PEERS
    PEERS/bin/pip install "setuptools<81" wheel sfft==1.7.3
    PEERS/bin/pip install --no-build-isolation tinynpydb
    PEERS/bin/pip install properimage
    OMP_NUM_THREADS=1 python -m benchmarks.studies.change_peers --peers PEERS/bin/python

``python -m benchmarks`` takes that interpreter from the environment variable ``STANDOFF_PEERS``.
What cannot be run is skipped, with the reason.
"""

import os
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.ndimage import binary_erosion

from analysis.changes import ChangeOptions, changes_between
from benchmarks.harness import Recorder, benchmark
from benchmarks.peers.changes import (
    AlignedPair,
    Peer,
    absolute_difference,
    cubic_warp,
    elsewhere,
    ir_mad,
    structural_dissimilarity,
    zogy,
)
from benchmarks.peers.program import PeerError
from benchmarks.scoring import PixelScores, changed_and_clear
from benchmarks.truth.lenses import Camera, f_number, gaussian
from benchmarks.truth.pairs import Development, PairPose, pair_of, scene, seen_spot
from calibration.registration import DistortedPose
from simulation.arrays import BoolArray, FloatArray

FRAME = (290, 390)
NOISE_DN = 1.2
BLUR_PX = 0.9
TPR = (0.5, 0.8, 0.9)
AMPLITUDE_DN, WIDTH_PX = 6.0, 1.5
CONTRAST_DN = 25.0
SEEDS = (1, 2)
POSES = (PairPose(zoom=1.0), PairPose(zoom=1.5, tilt_deg=5.0, bearing_deg=30.0))
SOFT = gaussian(BLUR_PX, has_pixel=False)
OURS = "standoff changes"
_PEERS = "STANDOFF_PEERS"
_RAW = Development(noise_dn=NOISE_DN)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kind:
    """Cameras, scenes and development of a kind of pair."""

    name: str
    scenes: tuple[str, ...] = ("texture", "lesion")
    cameras: tuple[Camera, Camera] = (SOFT, SOFT)
    blurs_px: tuple[float, float] = (BLUR_PX, BLUR_PX)
    before: Development = _RAW
    after: Development = _RAW
    distortion_k1: float = 0.0


_JPEG = Development(noise_dn=NOISE_DN, jpeg_quality=90)
_SHARP = replace(_JPEG, sharpening=(0.6, 1.0))
_AIRY = f_number(8.0)
KINDS = (
    _Kind(name="Gaussian lens"),
    _Kind(name="Airy lens, Mondrian", scenes=("mondrian",), cameras=(_AIRY, _AIRY),
         blurs_px=(0.62, 0.62)),
    _Kind(name="JPEG 90", before=_JPEG, after=_JPEG),
    _Kind(name="sharpened JPEG", before=_SHARP, after=_SHARP),
    _Kind(name="softer by 0.6 px^2",
         cameras=(SOFT, gaussian(sqrt(BLUR_PX**2 + 0.6), has_pixel=False)),
         blurs_px=(BLUR_PX, sqrt(BLUR_PX**2 + 0.6))),
    _Kind(name="sharper, 0.9 to 0.55 px", cameras=(SOFT, gaussian(0.55, has_pixel=False)),
         blurs_px=(BLUR_PX, 0.55)),
    _Kind(name="other camera, gamma", cameras=(gaussian(0.6, has_pixel=False), SOFT),
         blurs_px=(0.6, BLUR_PX),
         after=Development(noise_dn=NOISE_DN, gain=1.2, gamma=0.45)),
    _Kind(name="1 % of distortion", distortion_k1=-0.01),
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Case:
    """A pair as taken, what its change adds, and where a pixel of it lies in the reference."""

    aligned: AlignedPair
    change: FloatArray
    pose: DistortedPose


def _case(kind: _Kind, scene_name: str, pose: PairPose, seed: int) -> _Case:
    """A pair with 24 spots in the follow-up."""
    pose = replace(pose, distortion_k1=kind.distortion_k1)
    rows, cols = FRAME
    rng = np.random.default_rng(seed)
    places = [
        (x + rng.uniform(-3, 3), y + rng.uniform(-3, 3))
        for y in np.linspace(0.17, 0.83, 4) * rows
        for x in np.linspace(0.14, 0.86, 6) * cols
    ]
    # Spots are laid out in the reference's part that a further follow-up shows at its middle.
    middle = (cols - 1) / 2, (rows - 1) / 2
    spots = tuple(
        seen_spot(
            pose,
            FRAME,
            tuple(m + (at - m) / max(pose.zoom, 1.0) for at, m in zip(place, middle, strict=True)),
            sigma_px=WIDTH_PX,
            amplitude_dn=AMPLITUDE_DN * (-1) ** number,
            blur_px=kind.blurs_px[1],
        )
        for number, place in enumerate(places)
    )
    drawn = scene(scene_name, FRAME, 500 + seed, contrast_dn=CONTRAST_DN)
    plain = pair_of(drawn, FRAME, pose, kind.cameras)
    changed = pair_of(drawn, FRAME, pose, kind.cameras, spots)
    reference, followup = changed.developed(kind.before, kind.after, seed)
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    at_x, at_y = pose.positions(x, y, FRAME)
    zoom = max(pose.zoom, 1.0)
    warped, overlap = cubic_warp(reference, followup, at_y, at_x)
    return _Case(
        aligned=AlignedPair(
            reference=reference,
            followup=followup,
            warped=warped,
            overlap=overlap,
            noise_dn=(NOISE_DN, NOISE_DN),
            blur_px=(kind.blurs_px[0] / zoom, kind.blurs_px[1]),
        ),
        change=np.abs(changed.followup_dn - plain.followup_dn),
        pose=changed.pose.known(changed.frame),
    )


def _ours(made: _Case) -> tuple[FloatArray, BoolArray]:
    """Significance of this project's comparison, without a calibration, and what was compared."""
    options = ChangeOptions(pose=made.pose)
    found = changes_between(made.aligned.reference, made.aligned.followup, None, options)
    return np.abs(np.asarray(found.significance, dtype=np.float64)), found.valid


def _of_kind(record: Recorder, kind: _Kind, peers: dict[str, Peer]) -> None:
    """Score all frames of a kind by all detectors on the pixels that all of them see."""
    scores = {name: PixelScores() for name in (OURS, *peers)}
    skipped: dict[str, str] = {}
    frames = 0
    for scene_name in kind.scenes:
        for pose in POSES:
            for seed in record.pick(SEEDS, SEEDS[:1]):
                made = _case(kind, scene_name, pose, seed)
                significance, valid = _ours(made)
                valid = binary_erosion(valid, iterations=4)
                core, clear = changed_and_clear(made.change, valid)
                for name in scores.keys() - skipped.keys():
                    try:
                        score = significance if name == OURS else peers[name](made.aligned)
                    except PeerError as error:
                        skipped[name] = str(error)
                        continue
                    scores[name].add(score, core, clear)
                frames += 1
    record.say(f"{kind.name}: {frames} frames")
    false: dict[str, list[float]] = {}
    for name, found in scores.items():
        if name in skipped:
            record.say(f"  {name:28s} skipped: {skipped[name]}")
            continue
        false[name] = found.false_a_frame(TPR)
        record.say(f"  {name:28s} {'  '.join(f'{count:9.2f}' for count in false[name])}")
    ours = false.pop(OURS)
    for name, theirs in false.items():
        figure = f"{kind.name}, false pixels a frame at {100 * TPR[-1]:.0f} % true positives"
        record.figure(figure, ours[-1], "px", name, theirs[-1])


@benchmark("numpy", "scipy", "numba", "scikit-image")
def main(
    record: Recorder,
    *,
    peers: Annotated[Path | None, "interpreter that has sfft and properimage"] = None,
) -> None:
    peers = peers or (Path(given) if (given := os.environ.get(_PEERS)) else None)
    detectors: dict[str, Peer] = {
        "ZOGY, true PSFs": zogy,
        "IR-MAD": ir_mad,
        "SSIM map": structural_dissimilarity,
        "absdiff, SIFT and MAGSAC": absolute_difference,
    }
    if peers is not None:
        detectors |= {
            "SFFT": elsewhere("sfft", peers),
            "ZOGY, ProperImage": elsewhere("properimage", peers),
        }
    else:
        record.say("SFFT and ProperImage: skipped, no --peers")
    share = ", ".join(f"{100 * rate:.0f}" for rate in TPR)
    record.say(f"false pixels a frame at {share} % true positives")
    for kind in record.pick(KINDS, KINDS[:1]):
        _of_kind(record, kind, detectors)
