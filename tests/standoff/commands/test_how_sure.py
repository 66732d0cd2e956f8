"""From a calibration that knows its errors to limits and verdicts that say how sure they are."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from analysis.detectability import DetectabilityCurves, read_curves
from analysis.results_file import write_results
from benchmarks.truth.gaussian_scenes import GaussianScene
from simulation import GaussianPsf, zoom_out_image
from standoff.errors import ArgumentError
from tests.analysis.detectability.test_curves import curve
from tests.standoff.conftest import Command

PSF_PX2 = 0.64
SIGMA_ERR_PX = 0.02
ZOOMS = "1,1.01,1.15,1.3,1.6"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of a scene, a pair of zoom 1.25, and a calibration with its errors."""
    path = tmp_path_factory.mktemp("sure")
    rng, scene = np.random.default_rng(4), GaussianScene()
    for number in range(2):
        image = scene.photograph(256, PSF_PX2, rng)
        tifffile.imwrite(path / f"scene-{number}.tif", image.astype(np.float32))
    near = scene.photograph(420, PSF_PX2, rng)
    far = zoom_out_image(near, 1.25, GaussianPsf(sigma_px=PSF_PX2**0.5), "matched")
    tifffile.imwrite(path / "near.tif", near.astype(np.float32))
    tifffile.imwrite(path / "far.tif", (far + rng.normal(0, 0.5, far.shape)).astype(np.float32))
    calibration = {
        **{"schema": "standoff.psf/1", "sigma_x_px": 0.8, "sigma_y_px": 0.8, "rho": 0.0},
        **{"sigma_x_err_px": SIGMA_ERR_PX, "sigma_y_err_px": SIGMA_ERR_PX, "rho_err": 0.01},
        "estimate_covariance": np.diag([SIGMA_ERR_PX**2, SIGMA_ERR_PX**2, 1e-4]).tolist(),
    }
    (path / "psf.json").write_text(json.dumps(calibration))
    return path


def measured(command: Command, folder: Path, out: str, *more: object) -> DetectabilityCurves:
    done = command.done(
        *("detectability", folder / "scene-0.tif", folder / "scene-1.tif"),
        *("--psf", folder / "psf.json", "--noise", 2, "--contrast", 12, "--zooms", ZOOMS),
        *("--model", "matched", "--observer", "hotelling", "--out", folder / out, *more),
    )
    if "--focus-scatter" not in more:
        assert "unknown, and so not included in the intervals: the focus" in done.out
    return read_curves(folder / out)


@pytest.mark.slow
def test_what_is_known_of_the_camera_widens_intervals_and_makes_verdicts_unsure(
    command: Command, folder: Path
) -> None:
    bare = measured(command, folder, "bare.json").curves[0]
    loose = measured(command, folder, "loose.json", "--focus-scatter", 0.1).curves[0]
    assert bare.uncertainty is not None
    assert loose.uncertainty is not None
    # Two independent widths: the mean variance is sure to sigma err sqrt(2).
    assert bare.uncertainty.sources.psf_variance_err_px2 == pytest.approx(
        0.8 * SIGMA_ERR_PX * 2**0.5
    )
    assert loose.uncertainty.sources.focus_from == "stated"
    assert loose.dprime == bare.dprime
    for low, high, wide_low, wide_high in zip(
        bare.dprime_low, bare.dprime_high, loose.dprime_low, loose.dprime_high, strict=True
    ):
        assert wide_low < low < high
        assert wide_high / wide_low > high / low
    asked = ("--curves", folder / "bare.json", "--min-dprime", 2.2)
    camera = ("--focal-length-px", 964, "--image-size", "780x580", "--json")
    sharp = json.loads(command("limits", *asked, *camera).out)
    wide = json.loads(command("limits", *asked, *camera, "--focus-scatter", 0.05).out)
    assert wide["zoom"] == sharp["zoom"]
    for name in ("zoom_interval_95", "tilt_interval_95_deg"):
        assert wide[name][0] < sharp[name][0] < sharp[name][1] < wide[name][1]
    pair = ("pose", folder / "near.tif", folder / "far.tif", *asked)
    shown = command(*pair)
    assert shown.out.splitlines()[0].startswith("accepted: min d' ")
    assert shown.out.splitlines()[1].startswith("go: d' reaches the threshold with ")
    sure = json.loads(command(*pair, "--json").out)
    unsure = json.loads(command(*pair, "--json", "--focus-scatter", 0.15).out)
    assert (sure["is_accepted"], sure["verdict"]) == (True, "go")
    assert sure["probability"] > 0.95
    assert sure["unknown_sources"] == ["focus"]
    assert 0.005 < sure["focus_turning_px2"] < 0.15
    assert (unsure["is_accepted"], unsure["verdict"]) == (True, "unsure")
    assert unsure["budget"][0]["source"] == "focus"
    assert sum(one["share"] for one in unsure["budget"]) == pytest.approx(1)


def test_a_curve_of_before_does_not_pretend_to_know_the_focus(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    write_results(path, DetectabilityCurves(curves=[curve()]))
    with pytest.raises(ArgumentError, match="does not state how it depends on the focus"):
        standoff.pose_limits(
            path, 1.5, focal_length_px=900.0, image_size=(780, 580), focus_scatter_px2=0.1
        )
    with pytest.raises(ArgumentError, match="focus_scatter_px2: expected a number from 0"):
        standoff.pose_limits(
            path, 1.5, focal_length_px=900.0, image_size=(780, 580), focus_scatter_px2=-1.0
        )
