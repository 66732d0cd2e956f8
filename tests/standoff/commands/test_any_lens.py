"""From photographs of edges to a follow-up, by files and commands, for lenses of all kinds."""

import json
from math import ceil
from pathlib import Path

import numpy as np
import pytest
import tifffile

from benchmarks.truth.lens_scenes import Ideal, slanted_rectangles
from benchmarks.truth.lenses import Camera, astigmatic, edge_photographs, f_number, further
from simulation.arrays import FloatArray
from tests.standoff.conftest import Command

SIDE_PX, MARGIN_PX, ZOOM = 192, 48, 2.0
ALL_ROUND_DEG = tuple(8.0 + 22.5 * k for k in range(8))
CHART_DEG = (2.0, 92.0, 182.0, 272.0)
LEVELS_PER_DN = 200.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "angles_deg", "form"),
    [
        (f_number(1.4), ALL_ROUND_DEG, "round"),
        (f_number(5.6, defocus_waves=0.5), ALL_ROUND_DEG, "round"),
        (astigmatic(4.0, 2.0, 0.0), CHART_DEG, "elliptic"),
    ],
    ids=lambda one: one.name if isinstance(one, Camera) else "",
)
def test_the_follow_up_is_as_near_the_truth_as_a_linear_one_can_be(
    camera: Camera,
    angles_deg: tuple[float, ...],
    form: str,
    command: Command,
    tmp_path: Path,
) -> None:
    edges: list[Path] = []
    for photograph in edge_photographs(camera, angles_deg, 160, snr=500.0, seed=4):
        edges.append(tmp_path / f"edge{len(edges)}.tif")
        tifffile.imwrite(edges[-1], np.rint(photograph * LEVELS_PER_DN).astype(np.uint16))
    psf, reference_file, out = (tmp_path / name for name in ("psf.json", "near.tif", "far.tif"))
    command.done("calibrate", *edges, "--encoding", "linear", "--out", psf)
    document = json.loads(psf.read_text(encoding="utf-8"))
    # Edges as sharp as the pixel are edges too.
    assert {edge["image"] for edge in document["edges"]} == {str(edge) for edge in edges}
    assert document["transfer_2d"]["form"] == form

    scene = slanted_rectangles(SIDE_PX, 8, seed=9)
    reference = scene.reference(camera)
    tifffile.imwrite(reference_file, reference.astype(np.float32))
    simulated = command.done("simulate", reference_file, "--zoom", ZOOM, "--psf", psf, "--out", out)
    assert f"measured, {form}" in simulated.out

    margin = ceil(MARGIN_PX / ZOOM)
    far = tifffile.imread(out)[margin:-margin, margin:-margin].astype(np.float64)
    # Every follow-up pixel is centred on two by two of the reference.
    pixels: FloatArray = np.arange(margin, SIDE_PX / 2 - margin) * ZOOM + 0.5
    x, y = pixels[None, :], pixels[:, None]
    truth = scene.seen(further(camera, ZOOM), x, y)
    ideal = Ideal.of(scene, camera, 0.0).seen(reference, further(camera, ZOOM), x, y)
    best = float(np.mean((ideal - truth) ** 2))
    # 0.4 was measured at most of round lenses; with a Gaussian PSF it is 7, 60 and 25.
    assert float(np.mean((far - truth) ** 2)) < 1.5 * (best + 0.01)
