"""Errors that ``plan_study`` predicts against the scatter of sessions carried out on the bench.

Run with ``python -m benchmarks.studies.plan_study [--quick] [--plan N] [--seed S]``. Five plans
differ in frames, heights, edges, light, focus and photographs. Each is carried out again and again
on the simulated bench with the real calibrations; the scatter of n results is known to 1 / sqrt(2
n) of itself.
"""

from math import sqrt
from typing import Annotated, Literal

import numpy as np

from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.study_sessions import StudiedSession, achieved, calibrated

REPETITIONS = 100
BOARD_REPETITIONS = 60
FEWEST = 6
QUANTITIES = (
    "sigma_x_px",
    "sigma_y_px",
    "transfer_x",
    "transfer_y",
    "pupil_offset_mm",
    "d_prime",
    "tilt_limit_deg",
)


def _target(kind: str, orientations_deg: list[float], heights_mm: list[float]) -> dict[str, object]:
    """A target of a plan; the simulated bench has one of the kind's name."""
    return {
        "kind": kind,
        "target": kind,
        "orientations_deg": orientations_deg,
        "heights_mm": heights_mm,
    }


FAN = [5.0, 50.0, 95.0, 140.0]
PLANS = (
    StudiedSession(
        name="four angles, two heights",
        plan={
            "frames_per_capture": 4,
            "targets": [
                _target("edge", FAN, [180.0, 280.0]),
                _target("board", [0.0], [360.0, 400.0, 460.0, 520.0]),
            ],
        },
        photographs=4,
    ),
    StudiedSession(
        name="two angles, little light, repeated",
        plan={
            "frames_per_capture": 10,
            "repeats": 2,
            "targets": [
                _target("edge", [5.0, 95.0], [250.0]),
                _target("board", [0.0], [360.0, 440.0, 520.0]),
            ],
        },
        exposure_us=1500.0,
        scene="grass",
        photographs=8,
        contrast_dn=120.0,
    ),
    StudiedSession(
        name="focus that scatters, stage that scatters",
        plan={
            "frames_per_capture": 4,
            "targets": [
                _target("edge", FAN, [180.0, 400.0]),
                _target("board", [0.0], [360.0, 400.0, 440.0, 480.0, 520.0]),
            ],
        },
        focus_scatter_px2=0.03,
        height_scatter_mm=0.05,
        photographs=16,
    ),
    StudiedSession(
        name="two frames, little light, short edges",
        plan={
            "frames_per_capture": 2,
            "targets": [
                _target("edge", [8.0, 40.0, 98.0, 130.0], [250.0]),
                _target("board", [20.0], [420.0, 470.0, 520.0]),
            ],
        },
        bench={"width_px": 200, "height_px": 160, "read_noise_e": 25.0},
        exposure_us=1200.0,
        gain_relative_err=0.1,
        scene="brick",
        photographs=12,
        contrast_dn=60.0,
    ),
    StudiedSession(
        name="soft lens, three angles",
        plan={
            "frames_per_capture": 6,
            "targets": [
                _target("edge", [5.0, 65.0, 125.0], [220.0, 320.0]),
                _target("board", [0.0], [280.0, 300.0, 320.0, 340.0]),
            ],
        },
        bench={
            "width_px": 320,
            "height_px": 240,
            "optical_sigma_x_px": 1.1,
            "optical_sigma_y_px": 0.9,
        },
        exposure_us=5000.0,
        focus_scatter_px2=0.005,
        photographs=2,
        contrast_dn=100.0,
    ),
)


def _compare(record: Recorder, number: int, session: StudiedSession, seed: int) -> None:
    """Print predicted and achieved errors of one plan."""
    repetitions = record.pick(REPETITIONS, FEWEST)
    rng = np.random.default_rng([number, seed, 1])
    study = session.study(calibrated(session, rng), rng)
    boards = min(repetitions, BOARD_REPETITIONS)
    found = achieved(session, repetitions, boards, seed=(number, seed))
    record.say(
        f"\nplan {number}: {session.name}; {repetitions} repetitions, "
        f"whose scatter is known to {100 / sqrt(2 * repetitions):.0f} %, of the board {boards}"
    )
    record.say(f"{'':18}{'value':>10}{'predicted':>12}{'achieved':>12}{'ratio':>8}  mostly by")
    for name in QUANTITIES:
        predicted = next(one for one in study.predicted if one.quantity == name)
        if predicted.err is None or name not in found:
            record.say(f"{name:18} {predicted.undetermined}")
            continue
        scatter = float(np.std(found[name], ddof=1))
        ratio = predicted.err / scatter
        record.say(
            f"{name:18}{np.mean(found[name]):>10.4g}{predicted.err:>12.3g}{scatter:>12.3g}"
            f"{ratio:>8.2f}  {predicted.budget[0].source}"
        )
        record.figure(f"plan {number}, {name}: predicted over achieved error", ratio, "")


@benchmark("numpy", "scipy")
def main(
    record: Recorder,
    *,
    plan: Literal[1, 2, 3, 4, 5, None] = None,
    seed: Annotated[int, "other frames, focus and photographs"] = 0,
) -> None:
    for number, session in enumerate(PLANS, start=1):
        if plan in (None, number):
            _compare(record, number, session, seed)
