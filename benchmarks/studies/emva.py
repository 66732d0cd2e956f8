"""The data sheet of EMVA 1288 beside PyPI's emva1288, the standard's reference implementation.

A sensor in closed form: gain, read noise, a full well, and patterns of rows, columns and pixels in
the dark and in the response. Both programs get the same frames: two for each of 17 exposures, which
are close to each other near saturation, and sixteen in the dark and at about half of saturation, as
that package takes them. Each seed draws the frames anew, of one sensor: the scatter over seeds is
the repeatability with which the two are compared.

    python -m benchmarks.studies.emva [--peer PYTHON]

PYTHON is the interpreter of an environment of its own that has ``emva1288`` and numpy 1 (the
project has neither: it runs as a program beside).
"""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

import standoff
from benchmarks.harness import Recorder, benchmark

ROWS, COLS = 240, 320
K_DN_PER_E, READ_E, BLACK_DN, FULL_WELL_E = 0.25, 9.0, 60.0, 15_500.0
DARK_PARTS_E = {"rows": 1.5, "columns": 1.0, "pixels": 3.0}
RESPONSE_PARTS = {"rows": 0.002, "columns": 0.0015, "pixels": 0.006}
E_PER_US = 2.0
EXPOSURES_US = (
    *(400.0, 1000.0, 1700.0, 2400.0, 3100.0, 3875.0, 4600.0, 5400.0),
    *(6200.0, 6600.0, 7000.0, 7200.0, 7400.0, 7500.0, 7600.0, 7700.0, 8200.0),
)
MIDDLE_US = 3875.0
STACK, SEEDS = 16, 8

PEER = """
import json, sys
import numpy as np
from emva1288.process.loader import LoadImageData
from emva1288.process.data import Data1288
from emva1288.process.results import Results1288
images = json.load(open(sys.argv[1]))
images = {kind: {float(t): {float(p): files for p, files in levels.items()}
                 for t, levels in table.items()} for kind, table in images.items()}
found = Results1288(Data1288(LoadImageData(images, fload=np.load).data).data)
names = ("K", "sigma_d", "sigma_y_dark", "u_e_sat", "SNR_max_dB", "DR_dB", "DSNU1288",
         "DSNU1288_row", "DSNU1288_col", "DSNU1288_pixel", "PRNU1288", "PRNU1288_row",
         "PRNU1288_col", "PRNU1288_pixel")
values = {name: getattr(found, name) for name in names}
print(json.dumps({name: float(one() if callable(one) else one) for name, one in values.items()}))
"""

Frames = NDArray[np.uint16]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensor:
    """Dark level in electrons and response of every pixel, shape ``(rows, cols)``."""

    dark_e: NDArray[np.float64]
    response: NDArray[np.float64]

    @classmethod
    def drawn(cls) -> "Sensor":
        """Return the one sensor of this study."""
        rng = np.random.default_rng(1288)

        def pattern(parts: dict[str, float]) -> NDArray[np.float64]:
            shapes = {"rows": (ROWS, 1), "columns": (1, COLS), "pixels": (ROWS, COLS)}
            drawn = [rng.normal(0, parts[name], shape) for name, shape in shapes.items()]
            return np.asarray(sum(drawn) + np.zeros((ROWS, COLS)))

        return cls(dark_e=pattern(DARK_PARTS_E), response=1 + pattern(RESPONSE_PARTS))

    def frames(self, exposure_us: float, count: int, rng: np.random.Generator) -> Frames:
        """Frames of even light, of the dark at exposure 0."""
        light = rng.poisson(E_PER_US * exposure_us * self.response, (count, ROWS, COLS))
        full = np.minimum(light, FULL_WELL_E) + self.dark_e
        read = full + rng.normal(0, READ_E, light.shape)
        return np.clip(np.round(BLACK_DN + K_DN_PER_E * read), 0, 4095).astype(np.uint16)


def drawn_frames(sensor: Sensor, seed: int) -> dict[tuple[str, float], Frames]:
    """Frames of all exposures, in the dark and in the light."""
    rng = np.random.default_rng([1288, seed])
    return {
        (kind, exposure): sensor.frames(
            exposure if kind == "flat" else 0.0, STACK if exposure == MIDDLE_US else 2, rng
        )
        for exposure in EXPOSURES_US
        for kind in ("dark", "flat")
    }


def ours(frames: dict[tuple[str, float], Frames]) -> dict[str, float]:
    """Figures of our data sheet, by the names of the peer."""
    by_kind = {
        kind: {exposure: stack for (one, exposure), stack in frames.items() if one == kind}
        for kind in ("dark", "flat")
    }
    sheet = standoff.measure_noise(
        darks=by_kind["dark"], flats=by_kind["flat"], white_level=4095
    ).emva
    found = {
        "K": sheet.system_gain_dn_per_e,
        "sigma_d": sheet.dark_noise_e,
        "sigma_y_dark": sheet.dark_noise_dn,
        "u_e_sat": sheet.saturation_e,
        "SNR_max_dB": sheet.snr_max_db,
        "DR_dB": sheet.dynamic_range_db,
    }
    for name, parts, factor in (("DSNU1288", sheet.dsnu_e, 1.0), ("PRNU1288", sheet.prnu, 100.0)):
        found[name] = factor * parts.total
        found[f"{name}_row"] = factor * parts.rows
        found[f"{name}_col"] = factor * parts.columns
        found[f"{name}_pixel"] = factor * parts.pixels
    return found


def theirs(python: str, frames: dict[tuple[str, float], Frames]) -> dict[str, float]:
    """The same by emva1288, run as a program."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        listed: dict[str, dict[str, dict[str, list[str]]]] = {"temporal": {}, "spatial": {}}
        for (kind, exposure), stack in frames.items():
            files = []
            for number, frame in enumerate(stack):
                files.append(str(folder / f"{kind}_{exposure:g}_{number}.npy"))
                np.save(files[-1], frame)
            photons = "0.0" if kind == "dark" else str(2 * E_PER_US * exposure)
            listed["temporal"].setdefault(str(exposure), {})[photons] = files[:2]
            if exposure == MIDDLE_US:
                listed["spatial"].setdefault(str(exposure), {})[photons] = files
        (folder / "images.json").write_text(json.dumps(listed))
        (folder / "peer.py").write_text(PEER)
        done = subprocess.run(
            [python, str(folder / "peer.py"), str(folder / "images.json")],
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode != 0:
        sys.exit(f"{python} cannot run emva1288: {done.stderr.strip().splitlines()[-1]}")
    return {key: float(value) for key, value in json.loads(done.stdout.splitlines()[-1]).items()}


def truth(sensor: Sensor) -> dict[str, float]:
    """What is known of the sensor; of its patterns, those that were drawn."""
    found = {
        "K": K_DN_PER_E,
        "sigma_d": READ_E,
        "sigma_y_dark": float(np.sqrt((K_DN_PER_E * READ_E) ** 2 + 1 / 12)),
        "u_e_sat": FULL_WELL_E,
        "DSNU1288": float(np.std(sensor.dark_e)),
        "PRNU1288": 100 * float(np.std(sensor.response)),
    }
    for name, image, factor in (
        ("DSNU1288", sensor.dark_e, 1.0),
        ("PRNU1288", sensor.response, 100.0),
    ):
        rows, columns = image.mean(axis=1), image.mean(axis=0)
        single = image - rows[:, None] - columns + image.mean()
        found[f"{name}_row"] = factor * float(np.std(rows))
        found[f"{name}_col"] = factor * float(np.std(columns))
        found[f"{name}_pixel"] = factor * float(np.std(single))
    return found


def _spread(values: NDArray[np.float64]) -> str:
    return f"{values.mean():9.4f} ± {values.std(ddof=1):.4f}"


@benchmark("numpy", "scipy", note=f"{COLS} x {ROWS} px, {STACK} frames for the patterns")
def main(
    record: Recorder,
    *,
    peer: Annotated[str | None, "Python interpreter with emva1288 installed"] = None,
) -> None:
    """Compare figure by figure."""
    sensor = Sensor.drawn()
    seeds = record.pick(SEEDS, 3)
    mine, other = [], []
    for seed in range(seeds):
        frames = drawn_frames(sensor, seed)
        mine.append(ours(frames))
        if peer is not None:
            other.append(theirs(peer, frames))
    known = truth(sensor)
    record.say("figure: truth; ours, emva1288 (mean ± standard deviation of one run)")
    for name in mine[0]:
        our = np.array([one[name] for one in mine])
        line = f"{name:15s} {known.get(name, float('nan')):9.4f}  {_spread(our)}"
        if other:
            their = np.array([one[name] for one in other])
            apart = float(np.abs(our - their).max())
            scatter = float(their.std(ddof=1))
            line += f"  {_spread(their)}  apart {apart:.4f} at most"
            record.figure(
                f"{name}: mean difference from emva1288 over its repeatability",
                abs(float(our.mean() - their.mean())) / scatter, "",
            )  # fmt: skip
        record.say(line)
