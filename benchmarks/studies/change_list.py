"""The list of changes: places, amplitudes with their errors, and the share of false ones.

Scenes are photographed twice with ten spots in the second photograph, of widths 1 to 3 px and of 10
standard deviations of the filter matched to each, of both signs. ``Places`` and ``amplitudes``:
rms error along an axis, and how often 1.96 stated errors hold the truth. ``False share``: spots of
5 to 12 standard deviations, listed at a false discovery rate that was asked for. ``Clipped``: false
pixels where 1 to 3 % of the pixels of unchanged pairs are clipped.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.change_list
"""

from dataclasses import dataclass, replace
from math import pi, sqrt

import numpy as np

from analysis.changes import Change, ChangeOptions, ChangeResult, changes_between
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.pairs import Development, PairPose, Spot, pair_of, scene, seen_spot
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray

FRAME = (290, 390)
KINDS = ("texture", "retina", "lesion", "mondrian", "text")
POSES = (
    PairPose(zoom=1.0, turn_deg=3.0),
    PairPose(zoom=1.3, tilt_deg=5.0, bearing_deg=40.0),
    PairPose(zoom=1.5, shift=(0.04, -0.03)),
    PairPose(zoom=0.75, tilt_deg=4.0, bearing_deg=200.0),
)
NOISE_DN = 1.2
BLUR_PX = 0.9
WIDTHS_PX = (1.0, 3.0)
SPOTS = 10
FRAMES = 100
RATES = (0.05, 0.2)
CLIPPED = (0.01, 0.03)
MARGIN_PX, APART_PX, REACH_PX = 22.0, 20.0, 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Truth:
    """A spot as the follow-up shows it at the resolution of the coarser photograph."""

    x_px: float
    y_px: float
    amplitude_dn: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Case:
    """A pair with spots, and its true pose."""

    reference: FloatArray
    followup: FloatArray
    pose: DistortedPose
    spots: tuple[_Truth, ...]

    def found(self, options: ChangeOptions) -> ChangeResult:
        """Compare the two."""
        return changes_between(self.reference, self.followup, None, options)


def _spread_out(rng: np.random.Generator, pose: PairPose) -> list[tuple[float, float]]:
    """Places (x, y) in the follow-up, far from one another and from borders of both."""
    rows, cols = FRAME
    chosen: list[tuple[float, float]] = []
    while len(chosen) < SPOTS:
        x, y = rng.uniform(MARGIN_PX, cols - MARGIN_PX), rng.uniform(MARGIN_PX, rows - MARGIN_PX)
        u, v = (float(at[0]) for at in pose.positions(np.array([x]), np.array([y]), FRAME))
        is_inside = MARGIN_PX < u < cols - MARGIN_PX and MARGIN_PX < v < rows - MARGIN_PX
        if is_inside and all(np.hypot(x - a, y - b) > APART_PX for a, b in chosen):
            chosen.append((x, y))
    return chosen


def _case(number: int, snr: tuple[float, float], kinds: tuple[str, ...] = KINDS) -> _Case:
    """A pair with spots of so many standard deviations of their matched filters."""
    rng = np.random.default_rng(7000 + number)
    pose = POSES[number // len(kinds) % len(POSES)]
    kind = kinds[number % len(kinds)]
    zoom = pose.zoom
    # Noise of both at low frequencies, of the reference as it is seen.
    noise = NOISE_DN * sqrt(1 + 1 / zoom**2)
    truths, spots = [], list[Spot]()
    for x, y in _spread_out(rng, pose) if snr[1] > 0 else []:
        sigma = rng.uniform(*WIDTHS_PX) * max(1.0, 1 / zoom)
        amplitude = rng.uniform(*snr) * noise / (sqrt(pi) * sigma) * rng.choice([-1.0, 1.0])
        spots.append(
            seen_spot(pose, FRAME, (x, y), sigma_px=sigma, amplitude_dn=amplitude, blur_px=BLUR_PX)
        )
        # What is listed is the peak at the resolution of the coarser photograph.
        coarser_px2 = max(BLUR_PX / zoom, BLUR_PX) ** 2 - BLUR_PX**2
        lowered = sigma**2 / (sigma**2 + coarser_px2)
        truths.append(_Truth(x_px=x, y_px=y, amplitude_dn=amplitude * lowered))
    pair = pair_of(
        scene(kind, FRAME, 900 + number, contrast_dn=25.0), FRAME, pose, spots=tuple(spots)
    )
    shot = Development(noise_dn=NOISE_DN)
    reference, followup = pair.developed(shot, shot, number)
    return _Case(
        reference=reference,
        followup=followup,
        pose=pose.known(FRAME),
        spots=tuple(truths),
    )


def _nearest(truth: _Truth, changes: tuple[Change, ...]) -> Change | None:
    """The change found at a spot."""
    near = [c for c in changes if np.hypot(c.x_px - truth.x_px, c.y_px - truth.y_px) < REACH_PX]
    return max(near, key=lambda change: change.significance, default=None)


def _places_and_amplitudes(record: Recorder, frames: int) -> None:
    """Errors of spots of ten standard deviations of the matched filter."""
    off, scaled, ratio = [], [], []
    of_zoom: dict[float, list[float]] = {}
    spots = 0
    for number in range(frames):
        made = _case(number, (10.0, 10.0))
        changes = made.found(ChangeOptions(pose=made.pose)).summary.changes
        for truth in made.spots:
            spots += 1
            change = _nearest(truth, changes)
            if change is None:
                continue
            off.append((change.x_px - truth.x_px, change.y_px - truth.y_px))
            error = (change.amplitude_dn - truth.amplitude_dn) / change.amplitude_err_dn
            scaled.append(error * np.sign(truth.amplitude_dn))
            ratio.append(change.amplitude_dn / truth.amplitude_dn)
            of_zoom.setdefault(POSES[number // len(KINDS) % len(POSES)].zoom, []).append(error)
    place_rms = float(np.sqrt(np.mean(np.square(off))))
    z = np.array(scaled)
    held = 100 * float(np.mean(np.abs(z) < 1.96))
    record.say(
        f"{frames} frames, {spots} spots of 10 standard deviations, {len(off)} listed\n"
        f"  place: rms {place_rms:.3f} px an axis\n"
        f"  amplitude within 1.96 errors: {held:.1f} % (too low {100 * np.mean(z < -1.96):.1f}, "
        f"too high {100 * np.mean(z > 1.96):.1f}), over the truth {np.mean(ratio):.3f}"
    )
    for zoom, errors in of_zoom.items():
        inside = 100 * np.mean(np.abs(errors) < 1.96)
        record.say(f"  zoom {zoom:g}: {inside:.1f} % of {len(errors)}")
    record.figure("place of a spot of 10 standard deviations, rms an axis", place_rms, "px")
    record.figure("amplitudes within 1.96 stated errors", held, "%")
    record.figure("spots of 10 standard deviations listed", 100 * len(off) / spots, "%")


def _false_share(record: Recorder, frames: int) -> None:
    """Listed changes that are none, beside the rate asked for."""
    for rate in RATES:
        listed = false = hits = spots = 0
        shares = []
        for number in range(frames):
            made = _case(number, (5.0, 12.0))
            options = ChangeOptions(pose=made.pose, false_discovery_rate=rate)
            changes = made.found(options).summary.changes
            own = {id(_nearest(truth, changes)) for truth in made.spots} - {id(None)}
            listed += len(changes)
            false += len(changes) - len(own)
            hits += len(own)
            spots += len(made.spots)
            shares.append((len(changes) - len(own)) / max(len(changes), 1))
        share = float(np.mean(shares))
        record.say(
            f"asked for {rate:g}: {share:.3f} +- {np.std(shares) / sqrt(frames):.3f} of a frame's "
            f"changes are false, {false} of {listed}; {hits} of {spots} spots"
        )
        record.figure(f"false share at {rate:g}", share, "1", "asked", rate)


def clipped_pair(number: int, share: float) -> _Case:
    """An unchanged pair whose brightest pixels are clipped."""
    made = _case(number, (0.0, 0.0))
    top = float(np.quantile(made.followup, 1 - share))
    reference, followup = (
        np.minimum(np.rint(image), np.rint(top)) for image in (made.reference, made.followup)
    )
    return replace(made, reference=reference, followup=followup)


def _clipped(record: Recorder, frames: int) -> None:
    """False pixels of unchanged pairs whose brightest pixels are clipped."""
    for share in CLIPPED:
        worst = total = 0
        for number in range(frames):
            made = clipped_pair(3 * number, share)
            result = made.found(ChangeOptions(pose=made.pose))
            worst = max(worst, result.summary.changed_px)
            total += result.summary.changed_px
        record.say(
            f"{100 * share:g} % clipped: {total / frames:.2f} false pixels a frame, {worst} in the "
            f"worst of {frames}"
        )
        record.figure(f"false pixels, {100 * share:g} % clipped, worst frame", worst, "px")


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder) -> None:
    _places_and_amplitudes(record, record.pick(FRAMES, 10))
    _false_share(record, record.pick(FRAMES, 10))
    _clipped(record, record.pick(30, 5))
