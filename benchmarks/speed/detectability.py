"""Time of a curve of d' against zoom, beside a Monte Carlo of 1 % standard error.

One image of 600 x 450, 10 zooms, 3 observers, on one thread. Two peers: ``windows`` draws noise
in the observer's window alone and cuts the artefact out of the finished difference image;
``frames`` draws noise for whole images and simulates the change into each, as a script without
this algebra would. Both are timed on a part of their trials; the trials that 1 % needs follow
from d': ``2 / d'^2 / 1e-4 + 1 / (4 x 1e-4)``.

    OMP_NUM_THREADS=1 python -m benchmarks.speed.detectability
"""

import time

import numpy as np
from scipy.ndimage import gaussian_filter

from analysis.choices import OBSERVERS
from analysis.detectability import (
    GaussianSignal,
    LocalChange,
    Scenario,
    WindowCovariance,
    compared_pair,
    d_primes,
    local_changes,
    observer_templates,
    scene_artefact,
)
from benchmarks.harness import Recorder, benchmark
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from simulation.resampling import apply_separable
from tests.analysis.detectability_trials import run_trials

SHAPE = (450, 600)
ZOOMS = (1.0, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
QUICK_ZOOMS = (1.0, 1.5, 3.0)
PSF = GaussianPsf(sigma_x_px=0.935, sigma_y_px=0.935)
SPOT = GaussianSignal(sigma_px=2.0)
NOISE_DN, CONTRAST_DN = 2.0, 12.0
WINDOW_TRIALS, FRAME_TRIALS = 500, 10


def _trials_for_one_per_cent(d_prime: float) -> float:
    return 2 / (1e-4 * d_prime**2) + 1 / (4 * 1e-4)


def _analytic(scene: FloatArray, zoom: float) -> dict[str, float]:
    scenario = Scenario(psf=PSF)
    artefact = scene_artefact(scene, scenario, "matched", zoom)
    changes = local_changes(SPOT, Scenario(psf=PSF), "matched", zoom)
    return {
        name: CONTRAST_DN * one.value for name, one in d_primes(changes, artefact, NOISE_DN).items()
    }


def _window_trial_s(scene: FloatArray, zoom: float) -> float:
    """Time of one pair of trials for all observers, templates at hand."""
    change, templates, artefact = _prepared(scene, zoom)
    start = time.perf_counter()
    run_trials(
        change,
        templates,
        [artefact],
        contrast_dn=CONTRAST_DN,
        noise_dn=NOISE_DN,
        trials=WINDOW_TRIALS,
        rng=np.random.default_rng(0),
    )
    return (time.perf_counter() - start) / WINDOW_TRIALS


def _frame_trial_s(scene: FloatArray, zoom: float) -> float:
    """Time of one pair of trials that simulates both whole images."""
    _, templates, _ = _prepared(scene, zoom)
    pair = compared_pair(SHAPE, PSF, "matched", zoom)
    rng = np.random.default_rng(0)
    start = time.perf_counter()
    for _ in range(FRAME_TRIALS):
        for contrast_dn in (0.0, CONTRAST_DN):
            changed = scene.copy()
            changed[150:241, 200:291] += contrast_dn * SPOT.image(91, (0, 0))
            far = pair.followup.apply(changed)
            far = far + NOISE_DN * rng.standard_normal(far.shape)
            near = pair.reference_of(scene)
            near = near + NOISE_DN * rng.standard_normal(near.shape)
            difference = apply_separable(pair.up_y, pair.up_x, far) - near
            for template in templates:
                n = template.shape[0]
                float(np.sum(template * difference[80 : 80 + n, 100 : 100 + n]))
    return (time.perf_counter() - start) / FRAME_TRIALS


def _prepared(scene: FloatArray, zoom: float) -> tuple[LocalChange, list[FloatArray], FloatArray]:
    artefact = scene_artefact(scene, Scenario(psf=PSF), "matched", zoom)
    change = local_changes(SPOT, Scenario(psf=PSF), "matched", zoom)[0]
    covariance = WindowCovariance(
        NOISE_DN**2, change.up_y, change.up_x, artefact.autocovariance_dn2
    )
    templates = observer_templates(change.signal, covariance, OBSERVERS)
    image = compared_pair(SHAPE, PSF, "matched", zoom).artefact_of(scene)
    return change, list(templates.values()), image


def _compare(record: Recorder, zooms: tuple[float, ...]) -> None:
    """Sum the times over zooms."""
    rough = gaussian_filter(np.random.default_rng(0).standard_normal(SHAPE), 1.2)
    scene = 120 + 150 * rough
    _analytic(scene, 1.5)  # compiles
    took_s = dict.fromkeys(("analytic", "windows", "frames"), 0.0)
    for zoom in zooms:
        compared_pair.cache_clear()
        start = time.perf_counter()
        values = _analytic(scene, zoom)
        took_s["analytic"] += time.perf_counter() - start
        # The observer with the least d' decides how many trials are needed.
        trials = _trials_for_one_per_cent(min(values.values()))
        took_s["windows"] += trials * _window_trial_s(scene, zoom)
        took_s["frames"] += trials * _frame_trial_s(scene, zoom)
        shown = ", ".join(f"{name} {values[name]:.3f}" for name in OBSERVERS)
        record.say(f"zoom {zoom:.2f}, d' of {shown}")
    for what in ("windows", "frames"):
        record.figure(
            f"curve of d' over {len(zooms)} zooms",
            took_s["analytic"],
            "s",
            f"Monte Carlo of 1 % in {what}",
            took_s[what],
        )


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder) -> None:
    _compare(record, record.pick(ZOOMS, QUICK_ZOOMS))
