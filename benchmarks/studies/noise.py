"""Gain and read noise of the simulated bench against its truth, and beside PyPI's emva1288.

Run with ``python -m benchmarks.studies.noise [--peer PYTHON]``; PYTHON is the interpreter of an
environment of its own that has ``emva1288`` (the project's has not). Both get the same frames: two
for each level, as that package takes them. The scatter over 10 seeds tells whether our errors are
honest.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import load_bench
from benchmarks.harness import Recorder, benchmark
from calibration.noise import LevelSample, Saturation, fit_photon_transfer
from hil_mocks.truth import BenchTruth, CameraPose

CONFIGS = Path(__file__).parents[2] / "configs"
EXPOSURES_US = (700.0, 1400.0, 2800.0, 4200.0, 5600.0, 7000.0, 8400.0, 9800.0, 12600.0)
SEEDS = 10
PHOTONS_PER_US = 3.0

PEER = """
import json, sys
import numpy as np
from emva1288.process.loader import LoadImageData
from emva1288.process.data import Data1288
from emva1288.process.results import Results1288
images = json.load(open(sys.argv[1]))
images = {kind: {float(t): {float(p): files for p, files in levels.items()}
                 for t, levels in table.items()} for kind, table in images.items()}
data = Data1288(LoadImageData(images, fload=np.load).data)
found = Results1288(data.data)
print(json.dumps({"gain": 1 / float(found.K), "read": float(found.sigma_d)}))
"""

Pair = tuple[NDArray[np.uint16], NDArray[np.uint16]]


def _pair(
    truth: BenchTruth, kind: str, exposure_us: float, seed: int, view: tuple[slice, slice]
) -> Pair:
    """Two frames of the bench at one exposure."""
    light = truth.irradiance(kind, 0.0, CameraPose(height_mm=300.0))[view]
    electrons = truth.sensor.electrons(light, exposure_us)
    rng = np.random.default_rng([seed, round(exposure_us), kind == "dark"])
    first, second = (truth.sensor.expose(electrons, 0.0, "Mono12", rng) for _ in range(2))
    return first.astype(np.uint16), second.astype(np.uint16)


def _sample(kind: str, frames: Pair, exposure_us: float) -> LevelSample:
    """Those frames as a capture."""
    stack = np.stack(frames).astype(np.float64)
    return LevelSample(
        kind="dark" if kind == "dark" else "flat",
        capture=kind,
        mean_dn=float(stack.mean()),
        variance_dn2=float(stack.var(axis=0, ddof=1).mean()),
        pixels=stack[0].size,
        frames=2,
        exposure_us=exposure_us,
        time_s=0.0,
        clipped_fraction=float(np.mean(stack.max(axis=0) >= 4095)),
    )


def _ours(frames: dict[tuple[str, float], Pair]) -> tuple[float, float, float, float]:
    """Gain, its error, read noise, its error."""
    samples = [_sample(kind, both, exposure) for (kind, exposure), both in frames.items()]
    found = fit_photon_transfer(samples, Saturation(level_dn=4095.0, err_dn=0.3))
    return (
        found.gain_e_per_dn,
        found.gain_e_per_dn_err,
        found.read_noise_e,
        found.read_noise_e_err,
    )


def peer(python: str, frames: dict[tuple[str, float], Pair]) -> tuple[float, float]:
    """Gain and read noise by emva1288, from the same frames."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        levels: dict[str, dict[str, list[str]]] = {}
        for (kind, exposure), both in frames.items():
            files = []
            for number, image in enumerate(both):
                path = folder / f"{kind}_{exposure:g}_{number}.npy"
                np.save(path, image)
                files.append(str(path))
            photons = "0.0" if kind == "dark" else str(PHOTONS_PER_US * exposure)
            levels.setdefault(str(exposure), {})[photons] = files
        middle = str(EXPOSURES_US[len(EXPOSURES_US) // 2])
        images = {"temporal": levels, "spatial": {middle: levels[middle]}}
        (folder / "images.json").write_text(json.dumps(images))
        (folder / "peer.py").write_text(PEER)
        done = subprocess.run(
            [python, str(folder / "peer.py"), str(folder / "images.json")],
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode != 0:
        sys.exit(f"{python} cannot run emva1288: {done.stderr.strip().splitlines()[-1]}")
    result = json.loads(done.stdout.splitlines()[-1])
    return float(result["gain"]), float(result["read"])


def _compare(record: Recorder, python: str | None) -> None:
    """Print gain and read noise by seed, and how often the truth was within the errors."""
    truth = BenchTruth(load_bench(CONFIGS / "simulated.toml"))
    gain_true, read_true = truth.sensor.gain_e_per_dn, truth.sensor.read_noise_e
    record.say(f"truth: gain {gain_true} e/DN, read noise {read_true} e")
    part = (slice(0, 290), slice(0, 390))
    pulls = []
    seeds = record.pick(SEEDS, 3)
    for seed in range(seeds):
        view = (slice(None), slice(None)) if seed == 0 else part
        frames = {
            (kind, exposure): _pair(truth, kind, exposure, seed, view)
            for exposure in EXPOSURES_US
            for kind in ("dark", "flat")
        }
        gain, gain_err, read, read_err = _ours(frames)
        pulls.append(((gain - gain_true) / gain_err, (read - read_true) / read_err))
        record.say(
            f"seed {seed}: {gain:.4f} +- {gain_err:.4f} e/DN, {read:.3f} +- {read_err:.3f} e"
        )
        if seed == 0:
            peer_gain, peer_read = (None, None) if python is None else peer(python, frames)
            for what, found, true, theirs in (
                ("gain", gain, gain_true, peer_gain),
                ("read noise", read, read_true, peer_read),
            ):
                record.figure(
                    f"error of the {what}, two frames a level",
                    100 * abs(found / true - 1),
                    "%",
                    None if theirs is None else "emva1288",
                    None if theirs is None else 100 * abs(theirs / true - 1),
                )
                if theirs is not None:
                    record.say(
                        f"  emva1288: {what} {theirs:.4f} ({100 * (found / theirs - 1):+.2f} %)"
                    )
    inside = [int(np.sum(np.abs(np.array(pulls)[:, k]) < 2)) for k in (0, 1)]
    record.say(
        f"truth within 2 standard errors: gain {inside[0]}, read noise {inside[1]} of {seeds}"
    )


@benchmark("numpy", "scipy")
def main(
    record: Recorder,
    *,
    peer: Annotated[str | None, "Python interpreter with emva1288 installed"] = None,
) -> None:
    _compare(record, peer)
