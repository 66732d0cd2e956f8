import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition.photographs import read_photograph
from tests.standoff.conftest import FLAT_DN, FLAT_VARIANCE_DN2, Command


def _homography_file(path: Path, matrix: object, size: object, **more: object) -> Path:
    document = {"schema": "standoff.homography/1", "matrix": matrix, "size": size} | more
    path.write_text(json.dumps(document))
    return path


def test_a_lens_that_distorts_bends_both_images(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    # A ramp's level is its coordinate, which a blur leaves as it is. 20 px from the middle of the
    # follow-up is 20 / (1 + 0.04 (19.944 / 75)^2) = 19.944 px for an ideal lens, 29.915 px in the
    # reference, and is seen there at 29.915 (1 + 0.04 (29.915 / 75)^2) = 30.106 px.
    image = tmp_path / "ramp.tif"
    tifffile.imwrite(image, np.tile(np.arange(121, dtype=np.float32), (91, 1)))
    matrix = [[1.5, 0, 60 - 30 * 1.5], [0, 1.5, 45 - 22 * 1.5], [0, 0, 1]]
    pose = _homography_file(tmp_path / "H.json", matrix, [61, 45], distortion_k1=0.04)
    out = tmp_path / "far.tif"
    command.done("simulate", image, "--homography", pose, "--psf", psf_file, "--out", out)
    levels = tifffile.imread(out)[22]
    assert levels[30] == pytest.approx(60.0, abs=1e-3)
    assert levels[50] == pytest.approx(60 + 30.106, abs=0.002)


@pytest.mark.parametrize(
    ("k1", "message"),
    [
        ("much", "distortion_k1: 'much' is not a number"),
        (True, "distortion_k1: expected a number"),
        (10**400, "distortion_k1: 1000"),
        (0.5, "k1 must be between"),
        (-0.15, "k1 must be between"),
    ],
)
def test_a_distortion_at_fault_is_named(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, k1: object, message: str
) -> None:
    matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    pose = _homography_file(tmp_path / "H.json", matrix, [30, 30], distortion_k1=k1)
    out = tmp_path / "far.tif"
    err = command.refused(
        1, "simulate", image_file, "--homography", pose, "--psf", psf_file, "--out", out
    )
    assert "H.json" in err
    assert message in err
    assert not out.exists()


def test_a_homography_that_is_a_zoom_gives_what_the_zoom_gives(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    y, x = np.mgrid[:120, :150].astype(np.float64)
    blobs = 900.0 * np.exp(-((x - 70.3) ** 2 + (y - 61.1) ** 2) / (2 * 3.0**2)) + 100.0
    image = tmp_path / "blob.tif"
    tifffile.imwrite(image, blobs.astype(np.float32))
    # Pixel i of the follow-up lies at (i - (n - 1) / 2) z + (N - 1) / 2 of the reference.
    matrix = [[1.5, 0, 74.5 - 49.5 * 1.5], [0, 1.5, 59.5 - 39.5 * 1.5], [0, 0, 1]]
    pose = _homography_file(tmp_path / "H.json", matrix, [100, 80])
    by_pose, by_zoom, mask = (tmp_path / name for name in ("pose.tif", "zoom.tif", "nearer.png"))
    document = command.document(
        f"simulate {image} --homography {pose} --psf {psf_file} --out {by_pose} --nearer {mask}"
    )
    assert document["size"] == [100, 80]
    assert document["nearer_fraction"] == 0.0
    command("simulate", image, "--zoom", 1.5, "--psf", psf_file, "--out", by_zoom)
    np.testing.assert_allclose(
        tifffile.imread(by_pose),
        tifffile.imread(by_zoom),
        atol=2.0,  # of 900 DN
    )
    assert not read_photograph(mask).stored.any()


@pytest.mark.parametrize(
    ("matrix", "size", "name"),
    [
        ([[1, 0], [0, 1]], [10, 10], "matrix"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, "one"]], [10, 10], "matrix"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [10], "size"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [10, -1], "size"),
        ([[1, 0, 900], [0, 1, 0], [0, 0, 1]], [10, 10], "H.json"),
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], [10, 10], "H.json"),
    ],
)
def test_a_homography_at_fault_is_named(
    command: Command,
    image_file: Path,
    psf_file: Path,
    tmp_path: Path,
    matrix: object,
    size: object,
    name: str,
) -> None:
    pose = _homography_file(tmp_path / "H.json", matrix, size)
    out = tmp_path / "far.tif"
    err = command.refused(
        1, "simulate", image_file, "--homography", pose, "--psf", psf_file, "--out", out
    )
    assert name in err
    assert not out.exists()


def test_a_follow_up_from_another_pose_gets_the_noise_of_a_capture(
    command: Command, psf_file: Path, noise_file: Path, tmp_path: Path
) -> None:
    image, out = tmp_path / "flat.tif", tmp_path / "far.tif"
    rng = np.random.default_rng(4)
    pixels = rng.normal(FLAT_DN, np.sqrt(FLAT_VARIANCE_DN2), (200, 220))
    tifffile.imwrite(image, pixels.astype(np.float32))
    pose = _homography_file(
        tmp_path / "H.json", [[1.4, 0.2, 5], [-0.1, 1.5, 20], [0, 1e-4, 1]], [120, 100]
    )
    command.done(
        f"simulate {image} --homography {pose} --psf {psf_file} --noise {noise_file} --out {out}"
    )
    inner = tifffile.imread(out)[5:-5, 5:-5]
    # 9 900 pixels, correlated: the variance scatters by about 2 %.
    assert np.var(inner) == pytest.approx(FLAT_VARIANCE_DN2, rel=0.06)
