"""Calibrations and simulations: the command prints what the function returns."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from calibration.documents import json_object
from tests.calibration.blob_scene import blob_photograph
from tests.standoff.commands.board_session import BOARD_BENCH, BOARD_PLAN
from tests.standoff.conftest import SMALL_BENCH, Command
from tests.standoff.library.one_document import printed, without_caller

TILTED = """{"schema": "standoff.homography/1", "size": [40, 30],
    "matrix": [[1.9, 0.02, 4], [0.01, 1.8, 3], [2e-4, 0, 1]]}"""
NOISE_PLAN = """
schema = "standoff.plan/1"
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


def test_simulate(
    command: Command, image_file: Path, psf_file: Path, noise_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "far.tif"
    words = ("--zoom", 1.5, "--psf", psf_file, "--noise", noise_file, "--seed", 3)
    camera = ("--exposure", 0.9, "--vignetting", 0.1, "--sharpen", "0.5,1.2")
    done = command("simulate", image_file, *words, *camera, "--out", out, "--json")
    found = standoff.simulate(
        str(image_file),
        zoom=1.5,
        psf=psf_file,
        noise=noise_file,
        camera=standoff.CaptureOptions(exposure=0.9, vignetting=0.1, sharpening=(0.5, 1.2), seed=3),
    )
    assert printed(done) == without_caller(found.to_json())
    np.testing.assert_array_equal(tifffile.imread(out), np.asarray(found))
    found.write(tmp_path / "again.tif")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "again.tif"), found.image)


def test_simulate_of_another_pose(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    pose = tmp_path / "H.json"
    pose.write_text(TILTED)
    words = ("--homography", pose, "--psf", psf_file, "--out", tmp_path / "far.tif")
    done = command("simulate", image_file, *words, "--nearer", tmp_path / "nearer.png", "--json")
    found = standoff.simulate(image_file, homography=pose, psf=psf_file)
    document = printed(done)
    assert document == without_caller(found.to_json())
    assert document["outside_fraction"] == found.mask_fractions["outside_fraction"]
    matrix = standoff.simulate(image_file, homography=pose, psf=standoff.read_psf(psf_file))
    np.testing.assert_array_equal(matrix.image, found.image)


@pytest.mark.slow
def test_simulate_by_a_learned_kernel(command: Command, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    image_file, cache = tmp_path / "texture.tif", tmp_path / "kernels"
    texture = np.random.default_rng(6).integers(0, 4000, (150, 170)).astype(np.uint16)
    tifffile.imwrite(image_file, texture)
    words = ("--zoom", 2, "--model", "kernelgan", "--steps", 2, "--kernel-cache", cache)
    done = command("simulate", image_file, *words, "--out", tmp_path / "far.tif", "--json")
    found = standoff.simulate(image_file, zoom=2, model="kernelgan", steps=2, kernel_cache=cache)
    trained, stored = printed(done), without_caller(found.to_json())
    assert (trained.pop("kernel_from_cache"), stored.pop("kernel_from_cache")) == (False, True)
    assert trained == stored
    assert any("kernel taken from" in note for note in found.notes)


@pytest.mark.slow
def test_lens(command: Command, edge_file: Path, noise_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "lens.html"
    words = ("--noise", noise_file, "--operator", "A. Smith", "--pixel-pitch-um", 4.5)
    done = command("lens", edge_file, *words, "--out", out, "--json")
    found = standoff.measure_lens(
        edge_file, noise=noise_file, labels={"operator": "A. Smith"}, pixel_pitch_um=4.5
    )
    assert printed(done) == without_caller(found.to_json())
    standoff.write_lens(tmp_path / "again.csv", found)
    table = (tmp_path / "lens.csv").read_text("utf-8")
    assert (tmp_path / "again.csv").read_text("utf-8") == table


@pytest.mark.slow
def test_calibrate(command: Command, edge_file: Path, noise_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "psf.json"
    words = ("--noise", noise_file, "--region", "centre", "--pixel-pitch-um", 4.5, "--out", out)
    done = command("calibrate", edge_file, *words, "--json")
    psf = standoff.calibrate_psf(edge_file, noise=noise_file, region="centre", pixel_pitch_um=4.5)
    assert printed(done) == without_caller(json_object(psf))
    assert any("not determined by 1 edge" in note for note in psf.notes)
    assert all(note in done.err for note in psf.notes)
    table = psf.to_dataframe()
    assert table["sigma_px"].tolist() == [edge.sigma_px for edge in psf.edges]
    standoff.write_psf(tmp_path / "again.json", psf)
    assert standoff.read_psf(tmp_path / "again.json").sigma_x_px == psf.sigma_x_px


def test_calibrate_a_mosaic(command: Command, edge_file: Path, tmp_path: Path) -> None:
    words = ("--bayer", "RGGB", "--channel", "red", "--out", tmp_path / "psf.json", "--json")
    psf = standoff.calibrate_psf([edge_file], bayer="RGGB", channel="red")
    assert printed(command("calibrate", edge_file, *words)) == without_caller(json_object(psf))


@pytest.mark.slow
def test_calibrate_a_session(command: Command, session_dir: Path, tmp_path: Path) -> None:
    page = tmp_path / "psf.html"
    words = ("--session", session_dir, "--out", tmp_path / "psf.json", "--json")
    psf = standoff.calibrate_psf(standoff.Session(session_dir), report=page)
    assert printed(command("calibrate", *words)) == without_caller(json_object(psf))
    assert "PSF calibration" in page.read_text()


@pytest.mark.slow
def test_calibrate_from_two_distances_and_one_photograph(
    command: Command, noise_file: Path, tmp_path: Path
) -> None:
    covariance = np.array([[0.45, 0.0], [0.0, 0.33]])
    paths = [tmp_path / "near.tif", tmp_path / "far.tif"]
    for path, zoom in zip(paths, (1.0, 2.0), strict=True):
        tifffile.imwrite(path, blob_photograph(zoom, covariance, blobs=900).astype(np.float32))
    words = ("--method", "two-distance", "--zoom", 2, "--noise", noise_file, "--json")
    done = command("calibrate", *paths, *words, "--out", tmp_path / "psf.json")
    psf = standoff.calibrate_psf(paths, method="two-distance", zoom=2.0, noise=noise_file)
    assert printed(done) == without_caller(json_object(psf))
    with pytest.raises(standoff.ArgumentError, match="two photographs"):
        standoff.calibrate_psf(paths[0], method="two-distance", zoom=2.0)
    with pytest.raises(standoff.ArgumentError, match="edge target"):
        standoff.calibrate_psf(
            paths, method="two-distance", zoom=2.0, report=tmp_path / "report.html"
        )


def test_compare(command: Command, edge_file: Path, tmp_path: Path) -> None:
    paths = [tmp_path / "first-psf.json", tmp_path / "second-psf.json"]
    for path in paths:
        command.done("calibrate", edge_file, "--out", path)
    found = standoff.compare_psfs(*paths)
    assert printed(command("compare", *paths, "--json")) == without_caller(found.to_json())
    assert standoff.compare_psfs(*map(standoff.read_psf, paths)).verdict.startswith("no verdict")
    (tmp_path / "other-psf.json").write_text("{}")
    history = standoff.psf_history(tmp_path)
    done = command("compare", "--history", tmp_path, "--json")
    assert printed(done) == without_caller(history.to_json())
    assert [note in done.err for note in history.notes] == [True]


@pytest.mark.slow
def test_noise(command: Command, tmp_path: Path) -> None:
    session = command.captured(tmp_path, SMALL_BENCH, NOISE_PLAN)
    out, page = tmp_path / "noise.json", tmp_path / "noise.html"
    done = command("noise", "--session", session, "--out", out, "--json")
    found = standoff.measure_noise(session, report=page)
    (tmp_path / "again").mkdir()
    written = standoff.write_noise(tmp_path / "again" / out.name, found)
    assert printed(done) == without_caller(json_object(written))
    assert "Photon transfer" in page.read_text()


@pytest.mark.slow
def test_geometry(command: Command, tmp_path: Path) -> None:
    session = command.captured(tmp_path, BOARD_BENCH, BOARD_PLAN)
    out = tmp_path / "geometry.json"
    done = command("geometry", "--session", session, "--out", out, "--json")
    found = standoff.calibrate_geometry(session)
    assert printed(done) == without_caller(json_object(found))
    with pytest.raises(standoff.ArgumentError, match="scale_px_per_mm"):
        standoff.calibrate_geometry(session, scale_px_per_mm=-1.0)
    with pytest.raises(standoff.ArgumentError, match="board"):
        standoff.calibrate_geometry(session, board="eleven")


def test_what_does_not_go_together_is_an_argument_error(image_file: Path, psf_file: Path) -> None:
    for options, said in (
        ({}, "exactly one"),
        ({"zoom": 2.0}, "needs psf"),
        ({"homography": np.eye(3), "model": "paper", "psf": psf_file}, "homography needs"),
    ):
        with pytest.raises(standoff.ArgumentError, match=said):
            standoff.simulate(image_file, **options)
    with pytest.raises(standoff.ArgumentError, match="gamma:G"):
        standoff.reading("cubic")
    with pytest.raises(standoff.ArgumentError, match="page"):
        standoff.reading(page=2, mean=True)


class Watcher:
    """What `Progress` asks for, kept."""

    def __init__(self) -> None:
        self.done: dict[str, list[int]] = {}
        self.said: list[str] = []

    @contextmanager
    def bar(self, task: str, total: int) -> Iterator[Callable[[int], None]]:
        self.done[task] = [total]
        yield self.done[task].append

    def note(self, text: str) -> None:
        self.said.append(text)


def test_whoever_watches_sees_bars_and_notes_and_nothing_is_printed(
    edge_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    watcher = Watcher()
    psf = standoff.calibrate_psf([edge_file, edge_file], progress=watcher)
    total, *done = watcher.done["measuring edges"]
    assert total == 2
    assert done == sorted(done)
    assert done[-1] == total
    # Remarks on how files were read come at the end, on the result alone.
    assert [note for note in psf.notes if note in watcher.said] == watcher.said != []
    assert any("linear" in note for note in psf.notes)
    assert capsys.readouterr() == ("", "")
