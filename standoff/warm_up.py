"""Compiles the numerical code of the commands ahead: ``python -m standoff.warm_up``.

numba compiles a function when it is first called with arguments of some types, and keeps the result
beside its module. Set-up runs the commands over small pictures, so that nobody waits for that in
the middle of a measurement.
"""

import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from acquisition.averaging import average_frames
from acquisition.bench import load_bench
from acquisition.devices import FrameImage
from acquisition.focus import FOCUS_MEASURES, focus_value
from analysis.validation import scaled_up
from calibration.registration import RegistrationHints, register
from hil_mocks.scene import PeriodicImage
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf
from standoff.cli import run
from standoff.compile_notice import when_compiling
from standoff.compiled_cache import drop_stale_code
from standoff.library import open_bench
from standoff.shipped_configs import shipped_config

_SIDE_PX = 160
_FINER = 8
_ZOOM = 1.25
_SQUARE = (((-44, -44), (44, -44), (44, 44), (-44, 44)), 9.0, 0.8)  # corners, degrees, sigma in px
_HOMOGRAPHY = (
    '{"schema": "standoff.homography/1", "size": [120, 120],'
    ' "matrix": [[1.2, 0.02, 6.0], [0.01, 1.2, 6.0], [0.00005, 0.0, 1.0]]}'
)
_FILES = (
    "squares.png",
    "texture.png",
    "followup.tif",
    "other.tif",
    "psf.json",
    "pose.json",
    "curves.json",
    "changes",
)
_CALIBRATE = "calibrate {squares} --out {psf}"
_COMMANDS = (
    _CALIBRATE,
    f"{_CALIBRATE} --region 1,1,157,157",
    f"{_CALIBRATE} --bayer RGGB",
    f"{_CALIBRATE} --method paper",
    _CALIBRATE,  # the PSF of the commands below
    *(
        f"simulate {{texture}} --psf {{psf}} --model {model} --zoom 1.25 --out {{followup}}"
        for model in ("paper", "matched", "lmmse")
    ),
    *(
        f"simulate {{{image}}} --psf {{psf}} --model {model} --homography {{pose}} --out {{other}}"
        for model in ("matched", "lmmse")
        for image in ("texture", "followup")
    ),
    "detectability {texture} --psf {psf} --zooms 1,1.25 --noise 2 --contrast 40 --signal-sigma 2"
    " --out {curves}",
    "pose {texture} {followup} --curves {curves} --min-dprime 0.1 --model matched --observer npw",
    "changes {texture} {followup} --psf {psf} --out {changes}",
    "changes {texture} {followup} --out {changes}",
)


def squares(rng: np.random.Generator) -> FloatArray:
    """A dark square on white, tilted, with noise, in 16-bit levels."""
    corners, angle_deg, sigma_px = _SQUARE
    turn = np.deg2rad(angle_deg)
    c, s = np.cos(turn), np.sin(turn)
    outline = np.array(corners) @ np.array([[c, s], [-s, c]]) + _SIDE_PX / 2
    fine = np.zeros((_SIDE_PX * _FINER,) * 2, np.float32)
    cv2.fillPoly(fine, [np.rint(outline * _FINER).astype(np.int32)], (1.0,))
    blurred = np.asarray(cv2.GaussianBlur(fine, (0, 0), sigma_px * _FINER), dtype=np.float64)
    cover = blurred.reshape(_SIDE_PX, _FINER, _SIDE_PX, _FINER).mean(axis=(1, 3))
    return np.asarray(48e3 - 36e3 * cover + rng.normal(0, 60.0, cover.shape))


def texture(rng: np.random.Generator) -> FloatArray:
    """Soft noise with detail that two photographs can be registered by."""
    fine = rng.normal(size=(2 * _SIDE_PX,) * 2)
    level = cv2.GaussianBlur(fine, (0, 0), 1.5)
    return np.asarray(24e3 + 6e3 * level / level.std())


def _capture_and_focus() -> None:
    """What a bench computes on frames: mean, variance, every measure of focus, simulated detail."""
    frames: list[FrameImage] = []
    config = load_bench(shipped_config("demo_bench.toml"))
    with open_bench(config) as bench:
        mean = average_frames(bench.camera, 2, keep_frame=frames.append, clock=bench.clock)
    kinds = (frames[0], frames[0].astype(np.uint8), mean.mean_dn)
    for image, measure in product(kinds, FOCUS_MEASURES):
        focus_value(image, black_level_dn=0.0, measure=measure)
    place = np.linspace(0.0, 8.0, 4).reshape(2, 2)
    PeriodicImage(np.eye(8, dtype=np.float32)).blurred(place, place, 1.0)


def _validate(rng: np.random.Generator) -> None:
    """What a session's validation computes on pairs: their registration at a known zoom."""
    near = texture(rng)
    fewer = (round(len(near) / _ZOOM),) * 2
    far = np.asarray(cv2.resize(near, fewer, interpolation=cv2.INTER_AREA), dtype=np.float64)
    register(near, far, GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8), RegistrationHints(zoom=_ZOOM))
    scaled_up(far, _ZOOM, near.shape)


def warm_up() -> list[str]:
    """Run the commands over small pictures; return the functions that were compiled."""
    compiled: list[str] = []
    when_compiling(compiled.append)
    rng = np.random.default_rng(1)
    with TemporaryDirectory(prefix="standoff-") as folder:
        paths = {Path(name).stem: str(Path(folder) / name) for name in _FILES}
        for name, image in (("squares", squares(rng)), ("texture", texture(rng))):
            cv2.imwrite(paths[name], np.clip(np.rint(image), 0, 65535).astype(np.uint16))
        Path(paths["pose"]).write_text(_HOMOGRAPHY, encoding="utf-8")
        for command in _COMMANDS:
            said = StringIO()
            with redirect_stdout(said), redirect_stderr(said):
                status = run([*(word.format(**paths) for word in command.split()), "--force"])
            if status != 0:
                raise RuntimeError(f"standoff {command} ended with {status}: {said.getvalue()}")
    _capture_and_focus()
    _validate(rng)
    return compiled


def main() -> int:
    """Compile, and say so; what was compiled from other sources is removed first."""
    drop_stale_code()
    sys.stdout.write("Compiling the numerical code, once (about three minutes) ...\n")
    sys.stdout.flush()
    started = time.perf_counter()
    compiled = warm_up()
    taken_s = time.perf_counter() - started
    sys.stdout.write(f"{len(compiled)} functions compiled in {taken_s:.0f} s\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
