"""One sound file of every kind that a command reads, in a folder."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from standoff.cli import run
from standoff.shipped_configs import shipped_config
from tests.analysis.benchmark.hand_made_set import everything, write_json
from tests.analysis.height_series import height_series
from tests.calibration.closed_form import edge_image
from tests.calibration.edge_session import edge_session
from tests.fuzz.result_targets import CHANGES, CURVES, GEOMETRY, HOMOGRAPHY, NOISE, POSE, sound_psf
from tests.standoff.changed_photographs import FAR, NEAR, ZOOM, changed_pair
from tests.standoff.commands.board_session import BOARD_BENCH, BOARD_PLAN
from tests.standoff.conftest import SMALL_BENCH, SMALL_PLAN

SIDE = 96
TAKEN_PLAN = SMALL_PLAN.replace("[5.0, 50.0, 95.0]", "[5.0]")
NOISE_PLAN = """schema = "standoff.plan/1"
name = "noise"
heights_mm = [200.0]
frames_per_capture = 4
[[targets]]
kind = "dark"
target = "dark"
exposure_us = [21.0, 8000.0]
[[targets]]
kind = "flat"
target = "flat"
exposure_us = [1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 16000.0]
"""


def make_sound_files(folder: Path) -> None:
    """Write them all, and sessions: ``series``, ``edges``, ``board``, ``taken`` and ``noisy``."""
    rng = np.random.default_rng(5)
    levels = np.rint(edge_image(0.8, 5.0)).astype(np.uint16)
    tifffile.imwrite(folder / "edge.tif", levels)
    frames = np.random.default_rng(3).poisson(400, (4, 48, 64)).astype(np.uint16)
    tifffile.imwrite(folder / "frames.tif", frames, photometric="minisblack")
    pair = changed_pair(1, 25.0)
    tifffile.imwrite(folder / "near.tif", pair.reference.astype(np.float32))
    tifffile.imwrite(folder / "far.tif", pair.followup.astype(np.float32))
    scene = rng.integers(0, 4000, (SIDE, SIDE)).astype(np.uint16)
    tifffile.imwrite(folder / "scene.tif", scene)
    (folder / "photographs").mkdir()
    for name, levels_dn in (("near", pair.reference), ("far", pair.followup)):
        tifffile.imwrite(folder / "photographs" / f"{name}.tif", levels_dn.astype(np.float32))
    patch = np.exp(-np.add.outer(np.arange(-4, 5) ** 2, np.arange(-4, 5) ** 2) / 2)
    tifffile.imwrite(folder / "patch.tif", (12 * patch).astype(np.float32))
    Image.fromarray(np.zeros(FAR, np.uint8)).save(folder / "mask.png")
    psf = sound_psf()
    for name, document in {
        "psf": psf,
        "other-psf": psf | {"sigma_x_px": psf["sigma_x_px"] * 1.01},
        "curves": CURVES,
        "geometry": GEOMETRY
        | {
            "heights_mm": [100.0, 200.0],
            "focal_length_px": 900.0,
            "width_px": 780,
            "height_px": 580,
        },
        "H": HOMOGRAPHY | {"size": FAR[::-1], "matrix": _pose(), "distortion_k1": 0.0},
        "noise": NOISE | {"maps": _maps(folder)},
    }.items():
        (folder / f"{name}.json").write_text(json.dumps(document))
    (folder / "lens").mkdir()
    for name in ("psf.json", "other-psf.json"):
        shutil.copy(folder / name, folder / "lens" / name)
    (folder / "points.csv").write_text(_points())
    (folder / "limits.toml").write_bytes(shipped_config("limits.toml").read_bytes())
    (folder / "bench.toml").write_text(SMALL_BENCH)
    (folder / "plan.toml").write_text(TAKEN_PLAN)
    (folder / "noise-plan.toml").write_text(NOISE_PLAN)
    (folder / "board-bench.toml").write_text(BOARD_BENCH)
    (folder / "board-plan.toml").write_text(BOARD_PLAN)
    _, answers = everything(folder, data="benchmark", program="answers")
    write_json(answers, "about.json", {"name": "knows", "version": "1", "note": "the truth"})
    _make_sessions(folder)


def _make_sessions(folder: Path) -> None:
    results = height_series(folder / "series", heights_mm=(100.0, 120.0, 150.0)).path / "results"
    results.mkdir()
    for name, document in (("psf", sound_psf()), ("changes", CHANGES), ("pose", POSE)):
        (results / f"{name}.json").write_text(json.dumps(document))
    edge_session(folder / "edges")
    words = ("import", str(folder / "edge.tif"), "--kind", "edge", "--height-mm", "100")
    assert run([*words, "--out", str(folder / "imported")]) == 0
    for name, bench, plan in (
        ("taken", "bench.toml", "plan.toml"),
        ("noisy", "bench.toml", "noise-plan.toml"),
        ("board", "board-bench.toml", "board-plan.toml"),
    ):
        taken = run(
            [
                *("capture", "--bench", str(folder / bench), "--plan", str(folder / plan)),
                *("--out", str(folder / name), "--yes"),
            ]
        )
        assert taken == 0


def _pose() -> list[list[float]]:
    """What maps the follow-up onto the reference."""
    across = (NEAR[1] - 1) / 2 - ZOOM * (FAR[1] - 1) / 2 - 2.3
    return [[ZOOM, 0, across], [0, ZOOM, (NEAR[0] - 1) / 2 - ZOOM * (FAR[0] - 1) / 2], [0, 0, 1]]


def _points() -> str:
    """Four points of the follow-up, and where they are in the reference."""
    rows = ["followup_x_px,followup_y_px,reference_x_px,reference_y_px"]
    (scale, _, right), (_, _, down), _ = _pose()
    for x, y in ((20, 15), (190, 12), (25, 150), (180, 155)):
        rows.append(f"{x},{y},{scale * x + right:.2f},{scale * y + down:.2f}")
    return "\n".join(rows) + "\n"


def _maps(folder: Path) -> dict[str, Any]:
    planes: dict[str, Any] = {
        "dark": np.full((SIDE, SIDE), 64, np.float32),
        "flat": np.ones((SIDE, SIDE), np.float32),
        "defects": np.zeros((SIDE, SIDE), np.uint8),
    }
    listed = {}
    for name, plane in planes.items():
        path = folder / f"noise_{name}.tif"
        tifffile.imwrite(path, plane)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        listed[name] = {"file": path.name, "sha256": digest}
    return listed
