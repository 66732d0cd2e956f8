"""Make the files that the examples of the reference read: photographs, sessions and calibrations.

Run with ``python -m scripts.example_files FOLDER``. Photographs of edges are those of tests/data;
all else is taken on a small simulated bench.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

import standoff

_DATA = Path(__file__).parents[1] / "tests" / "data" / "edges"
_BENCH = """
[camera]
driver = "simulated"
pixel_format = "Mono12"
exposure_us = 12000.0
gain_db = 0.0
frame_rate_hz = 60.0

[stage]
driver = "simulated"
limits_mm = [120.0, 620.0]

[optics]
focal_length_mm = 8.0
pixel_pitch_um = 20.0

[capture]
frames_per_capture = 4

[simulated]
seed = 1
width_px = 320
height_px = 240
optical_sigma_x_px = 0.7
optical_sigma_y_px = 0.6
pupil_offset_mm = 12.5
"""
_PLAN = """
schema = "standoff.plan/1"
name = "coins"
heights_mm = [200.0, 300.0]

[[targets]]
kind = "texture"
target = "coins"
"""
_SESSION = """
schema = "standoff.plan/1"
name = "edges and coins"
heights_mm = [200.0, 240.0, 300.0]

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 50.0, 95.0]
heights_mm = [200.0]

[[targets]]
kind = "texture"
target = "coins"
"""
_FLATS = """
schema = "standoff.plan/1"
name = "noise"
heights_mm = [200.0]

[[targets]]
kind = "dark"
target = "dark"
exposure_us = [21.0, 8000.0]

[[targets]]
kind = "flat"
target = "flat"
exposure_us = [1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 16000.0]
"""
_DETECTOR = '''"""A detector: how different the brightest parts of two photographs are."""


def detector(reference, followup, homography):
    return abs(followup.max() - reference.max())
'''
_CHANGE_DN, _CHANGE_PX, _CHANGE_AT = 900.0, 2.0, (200.0, 90.0)
_TASK = standoff.DetectionTask(
    zooms=(1.0, 1.25, 1.5, 2.0),
    noises_dn=(12.0,),
    contrasts_dn=(120.0,),
    models=("matched",),
    observers=("hotelling",),
    reference_zoom=1.0,
    window_px=33,
)


def make_example_files(folder: Path) -> None:
    """Write all files into a folder, which is made."""
    folder.mkdir(parents=True)
    shutil.copy(_DATA / "v_edge.tif", folder / "vertical.tif")
    shutil.copy(_DATA / "h_edge.tif", folder / "horizontal.tif")
    for name, text in (
        ("bench.toml", _BENCH),
        ("plan.toml", _PLAN),
        ("session.toml", _SESSION),
        ("flats.toml", _FLATS),
        ("my_module.py", _DETECTOR),
    ):
        (folder / name).write_text(text, encoding="utf-8")
    _take_sessions(folder)
    _write_photographs(folder)
    _write_results(folder)


def _take_sessions(folder: Path) -> None:
    with standoff.Bench(folder / "bench.toml", operator="example") as bench:
        bench.home()
        bench.run(folder / "session.toml", folder / "session")
        bench.run(folder / "flats.toml", folder / "flats")
        bench.sweep(
            [160, 220, 300], folder / "board", target="board", kind="board", orientation_deg=5
        )


def _write_photographs(folder: Path) -> None:
    """Write coins from two heights, the further one with a spot more, and pictures of changes."""
    session = standoff.Session(folder / "session")
    near, middle, far = [
        np.rint(session.load(record).mean_dn).astype(np.uint16)
        for record in session.records
        if record.kind == "texture"
    ]
    y, x = np.indices(middle.shape, dtype=np.float64)
    square = (x - _CHANGE_AT[0]) ** 2 + (y - _CHANGE_AT[1]) ** 2
    spot = np.rint(_CHANGE_DN * np.exp(-square / (2 * _CHANGE_PX**2))).astype(np.uint16)
    tifffile.imwrite(folder / "before.tif", near)
    tifffile.imwrite(folder / "after.tif", middle + spot)
    tifffile.imwrite(folder / "stack.tif", np.stack([near, middle]))
    for inside, images in (
        ("photographs", {"near": near, "far": far}),
        ("after", {"day-1": middle, "day-2": middle + spot}),
    ):
        (folder / inside).mkdir()
        for name, image in images.items():
            tifffile.imwrite(folder / inside / f"{name}.tif", image)
    left_out = np.zeros(middle.shape, np.uint8)
    left_out[:40, :60] = 255
    Image.fromarray(left_out).save(folder / "moving-parts.png")
    depth = np.full(middle.shape, 290, np.float32)
    depth[60:180, 100:220] = 260
    tifffile.imwrite(folder / "depth.tif", depth)
    crack = np.zeros((9, 25, 4), np.uint8)
    crack[4, 2:23, 3] = 255
    Image.fromarray(crack).save(folder / "crack.png")


def _write_results(folder: Path) -> None:
    psf = standoff.calibrate_psf(standoff.Session(folder / "session"))
    standoff.write_psf(folder / "psf.json", psf)
    (folder / "lens-files").mkdir()
    for name in ("vertical", "horizontal"):
        edges = standoff.calibrate_psf(folder / f"{name}.tif")
        standoff.write_psf(folder / "lens-files" / f"psf-{name}.json", edges)
    standoff.write_noise(folder / "noise.json", standoff.measure_noise(folder / "flats"))
    geometry = standoff.calibrate_geometry(folder / "board")
    standoff.write_geometry(folder / "geometry.json", geometry)
    standoff.measure_curves(
        folder / "before.tif", folder / "curves.sweep", folder / "psf.json", _TASK
    ).write(folder / "curves.json")
    shutil.rmtree(folder / "curves.sweep")
    pose = standoff.register(folder / "before.tif", folder / "after.tif", folder / "psf.json")
    matrix = ", ".join(str([float(value) for value in row]) for row in pose.matrix)
    text = f'{{"schema": "standoff.homography/1", "matrix": [{matrix}], "size": [320, 240]}}'
    (folder / "H.json").write_text(text, encoding="utf-8")


def main() -> None:
    """Make the files of the command line's folder."""
    parser = argparse.ArgumentParser(description="The files that the reference's examples read.")
    parser.add_argument("folder", type=Path)
    make_example_files(parser.parse_args().folder)


if __name__ == "__main__":
    main()
