"""Comparisons, poses, curves and training pairs: the command prints what the function returns."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import standoff
from calibration.documents import json_object
from simulation.arrays import FloatArray
from tests.calibration.blob_scene import blob_photograph
from tests.standoff.conftest import Command
from tests.standoff.library.one_document import printed, without_caller

PSF = standoff.GaussianPsf(sigma_px=0.8)
CURVE: dict[str, Any] = {
    "model": "matched",
    "observer": "npw",
    "noise_dn": 2.0,
    "contrast_dn": 12.0,
    "signal_sigma_px": 2.0,
    "zoom": [1.0, 1.5, 2.0],
    "dprime": [6.0, 3.0, 1.0],
    "dprime_low": [5.5, 2.5, 0.5],
    "dprime_high": [6.5, 3.5, 1.5],
    "auc": [0.99, 0.98, 0.76],
}


def photograph(path: Path, zoom: float, spot_dn: float = 0.0) -> Path:
    """A scene in closed form, with a spot in it."""
    levels = blob_photograph(zoom, PSF.covariance_px2, blobs=900)
    y, x = np.indices(levels.shape)
    noise: FloatArray = np.random.default_rng(int(100 * zoom)).normal(0, 2, levels.shape)
    spot = spot_dn * np.exp(-((y - 90) ** 2 + (x - 140) ** 2) / 8)
    tifffile.imwrite(path, (levels + spot + noise).astype(np.float32))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs near and far, a PSF and curves."""
    path = tmp_path_factory.mktemp("pairs")
    photograph(path / "near.tif", 1.0)
    (path / "after").mkdir()
    for name, zoom in (("a", 1.3), ("b", 1.4)):
        photograph(path / "after" / f"{name}.tif", zoom, spot_dn=60.0)
    widths = {"schema": "standoff.psf/1", "sigma_x_px": 0.8, "sigma_y_px": 0.8, "rho": 0.0}
    (path / "psf.json").write_text(json.dumps(widths))
    curves = [CURVE, CURVE | {"observer": "hotelling"}]
    document = {"schema": "standoff.detectability/1", "curves": curves}
    (path / "curves.json").write_text(json.dumps(document))
    return path


@pytest.mark.slow
def test_changes(command: Command, folder: Path, tmp_path: Path) -> None:
    near, far, psf = folder / "near.tif", folder / "after" / "a.tif", folder / "psf.json"
    words = ("--psf", psf, "--expect-zoom", 1.3, "--false-alarms", 0.1, "--white-level", 4000)
    done = command("changes", near, far, *words, "--out", tmp_path / "by-command", "--json")
    found = standoff.find_changes(
        near,
        far,
        psf,
        hints=standoff.alignment_hints(1.3),
        false_alarms=0.1,
        white_level=4000,
    )
    assert printed(done) == without_caller(found.to_json())
    assert found.summary.changes
    found.write(tmp_path / "by-function")
    for path in (tmp_path / "by-command").glob("*.tif"):
        again = tifffile.imread(tmp_path / "by-function" / path.name)
        np.testing.assert_array_equal(tifffile.imread(path), again)
    table = found.summary.to_dataframe()
    assert table.significance.tolist() == [one.significance for one in found.summary.changes]


@pytest.mark.slow
def test_changes_of_a_series(command: Command, folder: Path, tmp_path: Path) -> None:
    near, after = folder / "near.tif", folder / "after"
    done = command("changes", near, after, "--out", tmp_path / "by-command", "--json")
    found = standoff.find_changes_of_series(near, after, tmp_path / "by-function")
    assert printed(done) == without_caller(found.to_json())
    assert found.document is not None
    assert found.document.compared == 2


@pytest.mark.slow
def test_pose_of_one_of_many_and_live(command: Command, folder: Path, tmp_path: Path) -> None:
    near, after, curves = folder / "near.tif", folder / "after", folder / "curves.json"
    words = ("--curves", curves, "--min-dprime", 2, "--observer", "npw")
    choice = standoff.CurveChoice(observer="npw")
    picture = tmp_path / "pose.png"
    done = command("pose", near, after / "a.tif", *words, "--picture", picture, "--json")
    found = standoff.judge_pose(near, after / "a.tif", curves, 2, choice=choice)
    assert printed(done) == without_caller(found.to_json(picture))
    assert found.is_accepted
    assert found.plot().axes

    done = command("pose", near, after, *words, "--out", tmp_path / "by-command", "--json")
    poses = standoff.judge_poses(near, after, tmp_path / "by-function", curves, 2, choice=choice)
    assert printed(done) == without_caller(poses.to_json())

    live = printed(command("pose", near, "--stream", after, *words, "--json"))
    watch = standoff.PoseWatch(near, curves, 2, choice=choice)
    watch.run(watch.folder(after))
    seen = without_caller(watch.to_json())
    assert live.pop("frames_per_s") != 0
    assert seen.pop("frames_per_s") != 0
    assert live == seen

    with pytest.raises(standoff.ArgumentError, match="curves match"):
        standoff.judge_pose(near, after / "a.tif", curves, 2)


def test_limits_of_a_known_pose(command: Command, folder: Path, tmp_path: Path) -> None:
    pose, curves = tmp_path / "H.json", folder / "curves.json"
    pose.write_text(
        """{"schema": "standoff.homography/1", "size": [60, 40],
        "matrix": [[1.1, 0.0, 3.0], [0.0, 1.1, 2.0], [0.0, 0.0, 1.0]]}"""
    )
    words = ("--curves", curves, "--min-dprime", 2, "--observer", "npw", "--homography", pose)
    done = command("limits", *words, "--reference-size", "78x58", "--json")
    found = standoff.judge_homography(
        pose,
        curves,
        2,
        choice=standoff.CurveChoice(observer="npw"),
        reference_size=(78, 58),
    )
    assert printed(done) == without_caller(found.to_json())


def test_limits(command: Command, folder: Path) -> None:
    words = ("--curves", folder / "curves.json", "--min-dprime", 2, "--observer", "npw")
    camera = ("--focal-length-px", 900, "--image-size", "780x580")
    tilts = ("--reference-tilt", 10, "--tilt-direction", 30, "--at-zoom", 1.2, "--at-tilt", 5)
    found = standoff.pose_limits(
        folder / "curves.json",
        2,
        choice=standoff.CurveChoice(observer="npw"),
        focal_length_px=900,
        image_size=(780, 580),
        reference_tilt_deg=10,
        direction_deg=30,
        at_zoom=1.2,
        at_tilt_deg=5,
    )
    done = command("limits", *words, *camera, *tilts, "--json")
    assert printed(done) == without_caller(found.to_json())


@pytest.mark.slow
def test_detectability(command: Command, folder: Path, tmp_path: Path) -> None:
    after, psf, out = folder / "after", folder / "psf.json", tmp_path / "curves.json"
    words = ("--zooms", "1,1.5", "--noise", 2, "--model", "matched", "--observer", "npw")
    done = command("detectability", after, "--psf", psf, *words, "--out", out, "--json")
    task = standoff.DetectionTask(
        zooms=(1.0, 1.5), noises_dn=(2.0,), models=("matched",), observers=("npw",)
    )
    measured = standoff.measure_curves(after, tmp_path / "state", psf, task)
    document = printed(done)
    figures = document.pop("figures")
    assert measured.curves is not None
    assert document == without_caller(json_object(measured.curves))
    assert len(measured.write(tmp_path / "again.json")) == len(figures)
    in_memory = standoff.d_prime_curves(sorted(after.iterdir()), psf, task)
    assert in_memory.curves[0].dprime == pytest.approx(measured.curves.curves[0].dprime)
    table = in_memory.to_dataframe()
    assert table.dprime.tolist() == in_memory.curves[0].dprime
    assert table.zoom.tolist() == [1.0, 1.5]


@pytest.mark.slow
def test_sr_pairs(command: Command, folder: Path, tmp_path: Path) -> None:
    words = ("--psf", folder / "psf.json", "--zoom", 2, "--crop", 64, "--test-fraction", 0.5)
    by_command, by_function = tmp_path / "by-command", tmp_path / "by-function"
    done = command("sr-pairs", folder / "after", *words, "--out", by_command, "--json")
    found = standoff.training_pairs(
        folder / "after",
        by_function,
        psf=folder / "psf.json",
        zoom=2,
        crop_px=64,
        test_fraction=0.5,
    )
    assert printed(done) == without_caller(found.to_json())
    for path in by_command.rglob("*.png"):
        assert (by_function / path.relative_to(by_command)).read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_change_pairs(command: Command, folder: Path, tmp_path: Path) -> None:
    words = ("--psf", folder / "psf.json", "--zooms", "1,1.5", "--crop", 48, "--pairs", 2)
    by_command, by_function = tmp_path / "by-command", tmp_path / "by-function"
    done = command("change-pairs", folder / "after", *words, "--out", by_command, "--json")
    found = standoff.change_pairs(
        folder / "after",
        by_function,
        folder / "psf.json",
        standoff.ChangePairsTask(zooms=(1, 1.5), crop_px=48, pairs=2),
    )
    assert printed(done) == without_caller(json_object(found.dataset))
    assert len(list(found.dataset.pairs("train"))) == found.dataset.train
    for path in by_command.rglob("*.npz"):
        assert (by_function / path.relative_to(by_command)).read_bytes() == path.read_bytes()
