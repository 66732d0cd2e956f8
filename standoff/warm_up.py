"""Compiles the numerical code of the commands ahead: ``python -m standoff.warm_up``.

numba compiles a function when it is first called with arguments of some types, and keeps the result
beside its module. Set-up runs the commands over small pictures, so that nobody waits for that in
the middle of a measurement: in two processes, as one compiles one function at a time.
"""

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from acquisition.averaging import average_frames
from acquisition.bench import load_bench
from acquisition.devices import FrameImage
from acquisition.focus import FOCUS_MEASURES, focus_value
from analysis.changes import ChangeOptions, changes_between
from analysis.validation import scaled_up
from calibration.edges import (
    EdgeFit,
    bin_edge,
    border_flags,
    edge_samples,
    esfr_half_width_px,
    find_edges,
    measure_esfr,
    roughness_px,
    without_shading,
)
from calibration.registration import DistortedPose, RegistrationHints, register_images
from hil_mocks.benchmark_set import benchmark_tasks
from hil_mocks.truth import PeriodicImage
from simulation import PoseOptions, SamplingGrid, zoom_out_on_grid
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf
from simulation.uncertainty import KnownErrors, SimulatedView, pixel_uncertainty
from standoff.cli import run
from standoff.compile_notice import when_compiling
from standoff.compiled_cache import EVERYTHING, compile_ahead, drop_stale_code
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
_PSF = (
    '{"schema": "standoff.psf/1", "sigma_x_px": 0.8, "sigma_y_px": 0.7, "rho": 0.1,'
    ' "method": "all-angles", "edges": []}'
)
_FILES = (
    "squares.png",
    "texture.png",
    "followup.tif",
    "other.tif",
    "measured.json",
    "psf.json",
    "pose.json",
    "curves.json",
    "changes",
)
_CALIBRATE = "calibrate {squares} --out {measured}"
_OF_EDGES = (_CALIBRATE, f"{_CALIBRATE} --method paper", f"{_CALIBRATE} --bayer RGGB")
_OF_THE_DEMO = tuple(
    f"simulate {{texture}} --psf {{psf}} --model {model} --zoom 1.25 --out {{followup}}"
    for model in ("paper", "matched", "lmmse")
)
_OF_PAIRS = (
    *(
        f"simulate {{{image}}} --psf {{psf}} --model {model} --homography {{pose}} --out {{other}}"
        for model in ("matched", "lmmse")
        for image in ("texture", "followup")
    ),
    "detectability {texture} --psf {psf} --zooms 1,1.25 --noise 2 --contrast 40 --signal-sigma 2"
    " --out {curves}",
    "pose {texture} {followup} --curves {curves} --min-dprime 0.1 --model matched --observer npw",
    "changes {texture} {followup} --psf {psf} --out {changes}",
)
_OF_CHANGES = ("changes {texture} {followup} --out {changes}",)


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
    """What a session's validation computes on pairs: their registration, and what they leave."""
    near = texture(rng)
    fewer = (round(len(near) / _ZOOM),) * 2
    far = np.asarray(cv2.resize(near, fewer, interpolation=cv2.INTER_AREA), dtype=np.float64)
    psf = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)
    pose = register_images(near, far, psf, RegistrationHints(zoom=_ZOOM)).pose
    scaled_up(far, _ZOOM, near.shape)
    zoom_out_on_grid(near, SamplingGrid.centred(near.shape, _ZOOM), psf, "matched")
    view = SimulatedView.of_pose(near.shape, pose.matrix, far.shape[::-1], PoseOptions())
    pixel_uncertainty(view, near, psf, KnownErrors(noise_dn2=np.ones_like(near)))


def _run(commands: tuple[str, ...], rng: np.random.Generator) -> None:
    """Run command lines over small pictures, whose paths they name."""
    with TemporaryDirectory(prefix="standoff-") as folder:
        paths = {Path(name).stem: str(Path(folder) / name) for name in _FILES}
        for name, image in (("squares", squares(rng)), ("texture", texture(rng))):
            cv2.imwrite(paths[name], np.clip(np.rint(image), 0, 65535).astype(np.uint16))
        for name, text in (("pose", _HOMOGRAPHY), ("psf", _PSF)):
            Path(paths[name]).write_text(text, encoding="utf-8")
        for command in commands:
            said = StringIO()
            with redirect_stdout(said), redirect_stderr(said):
                status = run([*(word.format(**paths) for word in command.split()), "--force"])
            if status != 0:
                raise RuntimeError(f"standoff {command} ended with {status}: {said.getvalue()}")


def _edges(rng: np.random.Generator) -> None:
    _run(_OF_EDGES, rng)


def _profiles(rng: np.random.Generator) -> None:
    """What a calibration computes on an edge once it is fitted."""
    image: Any = squares(rng).astype(np.float32)  # as `measure_edges` passes it on
    segment = find_edges(image)[0]
    fit = EdgeFit(
        x_px=segment.x_px,
        y_px=segment.y_px,
        angle_deg=float(np.rad2deg(segment.normal_rad) + 90.0) % 180.0,
        length_px=segment.length_px,
        sigma_px=0.85,
        sigma_err_px=0.01,
        optical_sigma_px=0.8,
        optical_sigma_err_px=0.01,
        low_dn=12e3,
        high_dn=48e3,
        noise_dn=60.0,
        curvature_per_px=0.0,
        chi2_reduced=None,
        flags=(),
    )
    samples = edge_samples(image, segment, fit, esfr_half_width_px(fit.sigma_px))
    even = without_shading(samples, image, segment, fit)
    border_flags(even, fit, is_jpeg=False)
    binned = bin_edge(even, fit)
    found = None if binned is None else measure_esfr(binned)
    if found is not None:
        found.esf(np.zeros(1))
    roughness_px(samples, fit.sigma_px)


def _demo(rng: np.random.Generator) -> None:
    _capture_and_focus()
    _validate(rng)
    _run(_OF_THE_DEMO, rng)


def _moved_things(
    rng: np.random.Generator, side_px: int, places: Sequence[tuple[int, int]]
) -> None:
    """What a comparison computes where things changed: patches, moved or nearer than the rest."""
    before, beneath = texture(rng), texture(rng)
    after = before.copy()
    for top, left in places:
        thing = beneath[top : top + side_px, left : left + side_px]
        before[top : top + side_px, left : left + side_px] = thing
        after[top + 2 : top + 2 + side_px, left + 1 : left + 1 + side_px] = thing
    pose = DistortedPose(
        matrix=np.eye(3), k1=0.0, reference_shape=before.shape, followup_shape=after.shape
    )
    first, second = (image + rng.normal(0, 200.0, image.shape) for image in (before, after))
    changes_between(first, second, None, ChangeOptions(pose=pose))


def _changes(rng: np.random.Generator) -> None:
    _moved_things(rng, 12, ((20, 20), (90, 90)))
    _moved_things(rng, 36, ((20, 20), (20, 100), (90, 60)))
    _run((*_OF_THE_DEMO[:1], *_OF_CHANGES), rng)


def _pairs(rng: np.random.Generator) -> None:
    _run((*_OF_THE_DEMO[:1], *_OF_PAIRS), rng)


def _benchmark(_: np.random.Generator) -> None:
    """What the public benchmark's photographs are rendered by: charts, lenses, scenes."""
    for task in benchmark_tasks("tiny", 1):
        if task.track == "psf":
            task.rendered()


_WORK: dict[str, Callable[[np.random.Generator], None]] = {
    "edges": _edges,
    "benchmark": _benchmark,
    "profiles": _profiles,
    "demo": _demo,
    "changes": _changes,
    "pairs": _pairs,
}


def main(arguments: list[str]) -> int:
    """Compile, and say so; what was compiled from other sources is removed first."""
    if arguments:
        compiled: list[str] = []
        when_compiling(compiled.append)
        for work in arguments:
            _WORK[work](np.random.default_rng(1))
        sys.stdout.write(f"{len(compiled)}\n")
        return 0
    drop_stale_code()
    sys.stdout.write("Compiling the numerical code, once (about a minute) ...\n")
    sys.stdout.flush()
    started = time.perf_counter()
    count = compile_ahead(EVERYTHING)
    taken_s = time.perf_counter() - started
    sys.stdout.write(f"{count} functions compiled in {taken_s:.0f} s\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
