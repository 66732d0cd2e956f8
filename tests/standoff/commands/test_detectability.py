import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.ndimage import gaussian_filter

from analysis.detectability._curves import DetectabilityCurves, read_curves
from analysis.results_file import write_results
from simulation import GaussianPsf, zoom_out_image
from tests.analysis.detectability.test_curves import curve
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.9)


@pytest.fixture
def psf_file(tmp_path: Path) -> Path:
    path = tmp_path / "psf.json"
    path.write_text(
        json.dumps({"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_y_px": 0.9, "rho": 0.0})
    )
    return path


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.tif"
    rough = gaussian_filter(np.random.default_rng(1).standard_normal((200, 240)), 1.2)
    tifffile.imwrite(path, (120 + 150 * rough).astype(np.float32))
    return path


@pytest.fixture
def curves_file(tmp_path: Path) -> Path:
    path = tmp_path / "known.json"
    write_results(path, DetectabilityCurves(curves=[curve(), curve(observer="hotelling")]))
    return path


FAST = ("--window", 15, "--zooms", "1.5,1", "--observer", "npw,cho")


@pytest.mark.slow
def test_curves_and_figures_are_written_and_a_second_run_finds_its_cells(
    command: Command, scene_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "curves.json"
    asked = ("detectability", scene_file, "--psf", psf_file, "--model", "paper,matched", *FAST)
    done = command.done(*asked, "--noise", "2,4", "--contrast", "6,12", "--out", out)
    assert "upper bound" in done.out
    assert "which row to read: npw takes the scene's detail for white noise; cho comes" in done.out
    first = json.loads(out.read_text())
    assert_provenance(first, "detectability", psf_file, scene_file)
    curves = read_curves(out).curves
    assert len(curves) == 2 * 2 * 2 * 2
    assert curves[0].zoom == [1.0, 1.5]
    for name in ("noise.png", "noise.svg", "contrast.png", "contrast.svg"):
        assert (tmp_path / f"curves-{name}").stat().st_size > 5000
    sums = {path: path.stat().st_mtime_ns for path in (tmp_path / "curves.sweep").iterdir()}
    assert len([path for path in sums if path.suffix == ".records"]) == 1
    done = command(*asked, "--noise", "2,4", "--contrast", "6,12", "--out", out, "--json")
    assert json.loads(done.out)["schema"] == "standoff.detectability/1"
    again = json.loads(out.read_text())
    assert again | {"provenance": None} == first | {"provenance": None}
    assert {path: path.stat().st_mtime_ns for path in sums} == sums
    # The same question goes on; another one does not take its place.
    other = command(*asked, "--noise", "2,4", "--contrast", "24", "--out", out)
    assert (other.status, other.err.count("\n")) == (1, 1)
    assert f"{out} exists already; --force replaces it" in other.err
    assert json.loads(out.read_text()) == again


@pytest.mark.slow
def test_what_cannot_be_measured_is_named_and_the_curves_are_of_the_others(
    command: Command, scene_file: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "photographs"
    folder.mkdir()
    for name in ("a.tif", "b.tif", "copy.tif"):
        levels = tifffile.imread(scene_file) + (name == "b.tif")
        tifffile.imwrite(folder / name, levels)
    (folder / "corrupt.tif").write_bytes((folder / "a.tif").read_bytes()[:300])
    missing = tmp_path / "missing.tif"
    out = tmp_path / "curves.json"
    asked = ("detectability", folder, missing, "--model", "bicubic", *FAST, "--out", out)
    err = command.refused(1, *asked)
    assert "standoff: 2 photographs could not be measured" in err
    assert "are from the other 3" in err
    assert "1 photograph has the same content as another" in err
    listed = (tmp_path / "curves.sweep" / "refused.txt").read_text()
    assert listed.count("\n") == 2
    for path in (folder / "corrupt.tif", missing):
        assert str(path) in listed
        assert str(path) in err
    copies = (tmp_path / "curves.sweep" / "copies.txt").read_text()
    assert [line[66:] for line in copies.splitlines()] == [
        str(folder / name) for name in ("a.tif", "copy.tif")
    ]
    document = json.loads(out.read_text())
    assert document["images"] == 3
    files = [folder / name for name in ("a.tif", "b.tif", "copy.tif")]
    assert_provenance(document, "detectability", *files)
    err = command.refused(1, *asked, "--strict")
    assert err.count("\n") == 1


@pytest.mark.slow
def test_parts_of_a_queue_and_a_last_run_give_the_curves_of_one_run(
    command: Command, scene_file: Path, tmp_path: Path
) -> None:
    images = [tmp_path / f"{number}.tif" for number in range(3)]
    for number, path in enumerate(images):
        tifffile.imwrite(path, np.roll(tifffile.imread(scene_file), 20 * number))
    asked = ("detectability", *images, "--model", "bicubic", *FAST)
    command.done(*asked, "--out", tmp_path / "one.json")
    out = tmp_path / "parts.json"
    for k in (2, 1):
        done = command.done(*asked, "--out", out, "--shard", f"{k}/2")
        assert f"part {k}/2: " in done.out
        assert not out.exists()
    command.done(*asked, "--out", out)
    assert read_curves(out).curves == read_curves(tmp_path / "one.json").curves


@pytest.mark.slow
def test_noise_of_a_camera_and_a_patch_as_signal(
    command: Command, scene_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    noise = tmp_path / "noise.json"
    noise.write_text(
        '{"schema": "standoff.noise/1", "gain_e_per_dn": 10.0, "read_noise_e": 5.0,'
        ' "black_level_dn": 20.0, "frames_averaged": 1}'
    )
    tifffile.imwrite(tmp_path / "patch.tif", np.pad(np.ones((4, 4), np.uint8), 2))
    out = tmp_path / "curves.json"
    command.done(
        *("detectability", scene_file, "--psf", psf_file, "--model", "matched", *FAST),
        *("--noise", noise, "--signal", tmp_path / "patch.tif", "--out", out),
    )
    found = read_curves(out).curves[0]
    mean_dn = float(tifffile.imread(scene_file).astype(np.float64).mean())
    assert found.noise_dn == pytest.approx(np.sqrt((mean_dn - 20) / 10 + 0.25))
    assert found.signal_sigma_px is None


LIMITS = ("--focal-length-px", 800, "--image-size", "640x480", "--observer", "npw")


def test_limits_as_table_json_and_plot(command: Command, curves_file: Path, tmp_path: Path) -> None:
    asked = ("limits", "--curves", curves_file, "--min-dprime", 3, *LIMITS)
    plot = tmp_path / "limits.svg"
    done = command.done(*asked, "--plot", plot, "--at-zoom", 1.5)
    assert "straight back: up to 1.167 times the reference's distance" in done.out
    assert "contrasts from 18 DN are detectable" in done.out
    assert plot.read_bytes().startswith(b"<?xml")
    document = json.loads(command(*asked, "--json").out)
    assert document["zoom"] == pytest.approx(7 / 6)  # where 4 / (2 z - 1) is 3
    assert document["is_upper_bound"] is True


def test_limits_from_a_geometry_file(command: Command, curves_file: Path, tmp_path: Path) -> None:
    stored = {
        **{"schema": "standoff.geometry/1", "heights_mm": [200.0], "scale_px_per_mm": [4.0]},
        **{"pupil_offset_mm": 3.0, "k1": None, "k2": None, "tilt_deg": None},
        **{"axis_drift_px_per_mm": None, "focal_length_px": 800.0},
        **{"width_px": 640, "height_px": 480},
    }
    path = tmp_path / "geometry.json"
    path.write_text(json.dumps(stored))
    asked = ("limits", "--curves", curves_file, "--min-dprime", 3, "--observer", "npw", "--json")
    by_file = json.loads(command(*asked, "--geometry", path).out)
    assert by_file == json.loads(command(*asked, *LIMITS[:4]).out)
    path.write_text(json.dumps(stored | {"focal_length_px": None}))
    err = command.refused(1, *asked, "--geometry", path)
    assert "the focal length or the frame is not determined" in err
    path.write_text(json.dumps(stored | {"height_px": 2**63}))
    err = command.refused(1, *asked, "--geometry", path)
    assert f"{path}: a frame of 16 to 1,000,000 px a side is needed" in err


def test_limits_towards_a_direction_are_a_table_and_a_camera_is_given_once(
    command: Command, curves_file: Path, tmp_path: Path
) -> None:
    asked = ("limits", "--curves", curves_file, "--min-dprime", 3, *LIMITS)
    done = command.done(*asked, "--tilt-direction", 90)
    assert "tilt towards 90 degrees at the same distance" in done.out
    assert "contrasts from" not in done.out  # no pose was asked about
    err = command.refused(2, *asked, "--geometry", tmp_path / "geometry.json")
    assert "give exactly one of --geometry, --focal-length-px and --homography" in err


def test_a_frame_size_may_have_a_comma_and_a_focal_length_its_unit(
    command: Command, curves_file: Path
) -> None:
    asked = ("limits", "--curves", curves_file, "--min-dprime", 3, "--observer", "npw", "--json")
    camera = command(*asked, "--focal-length-px", 800, "--image-size", "640x480")
    same = command(*asked, "--focal-length-px", "800 px", "--image-size", "640, 480")
    assert camera.status == 0, camera.err
    assert same.out == camera.out


@pytest.mark.slow
def test_a_pose_is_registered_and_judged(
    command: Command, scene_file: Path, curves_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    far = tmp_path / "far.tif"
    tifffile.imwrite(far, zoom_out_image(tifffile.imread(scene_file), 1.3, PSF))
    picture = tmp_path / "pose.png"
    asked = ("pose", scene_file, far, "--curves", curves_file, "--observer", "npw")
    accepted = command.done(*asked, "--min-dprime", 2.4, "--psf", psf_file, "--picture", picture)
    assert accepted.out.startswith("accepted: min d' 2.5")
    assert picture.read_bytes().startswith(b"\x89PNG")
    document = json.loads(command(*asked, "--min-dprime", 2.6, "--json").out)
    assert document["is_accepted"] is False
    # Straight back by 1.3: d' of the curve there is 4 / (2 z - 1).
    assert document["dprime_decisive"] == pytest.approx(2.5, abs=0.03)
    assert document["overlap"] == 1.0
    assert command(*asked[:5], "--min-dprime", 2).status == 2


@pytest.mark.slow
def test_images_that_do_not_match_are_told_in_one_line(
    command: Command, scene_file: Path, curves_file: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.tif"
    rng = np.random.default_rng(9)
    tifffile.imwrite(other, rng.normal(100, 5, (150, 180)).astype(np.float32))
    err = command.refused(
        1,
        *("pose", scene_file, other, "--curves", curves_file),
        *("--min-dprime", 2, "--observer", "npw"),
    )
    assert f"{other}: " in err
    assert err.count("\n") == 1
