import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from tests.standoff.conftest import Command

IDENTITY = """{"schema": "standoff.homography/1", "size": [60, 40],
    "matrix": [[1.5, 0, 5], [0, 1.5, 5], [0, 0, 1]]}"""


@pytest.fixture
def waves(tmp_path: Path) -> Path:
    y, x = np.mgrid[0:90, 0:120]
    path = tmp_path / "waves.tif"
    tifffile.imwrite(path, (500 + 100 * np.sin(0.4 * x + 0.3 * y)).astype(np.float32))
    return path


@pytest.fixture
def known_psf(tmp_path: Path) -> Path:
    path = tmp_path / "known.json"
    widths = {
        "sigma_x_px": 0.8,
        "sigma_x_err_px": 0.008,
        "sigma_y_px": 0.8,
        "sigma_y_err_px": 0.008,
    }
    path.write_text(json.dumps({"schema": "standoff.psf/1", **widths, "rho": 0.0, "rho_err": 0.01}))
    return path


def test_noise_of_a_flat_reference_is_what_the_weights_leave(
    command: Command, known_psf: Path, tmp_path: Path
) -> None:
    # A flat scene has nothing that PSF or focus could change: the noise of 2 DN alone is left, and
    # at zoom 1 as it is.
    flat, out, err = tmp_path / "flat.tif", tmp_path / "far.tif", tmp_path / "err.tif"
    tifffile.imwrite(flat, np.full((40, 50), 300.0, np.float32))
    words = ("--psf", known_psf, "--out", out, "--uncertainty", err, "--reference-noise", 2)
    scale = ("--zoom", 1, "--focus-scatter", 0.05)
    document = command.document("simulate", flat, *words, *scale)["uncertainty"]
    assert tifffile.imread(err) == pytest.approx(np.full((40, 50), 2.0, np.float32), abs=1e-4)
    assert document["median_dn"] == pytest.approx(2.0, abs=1e-4)
    assert document["median_dn_by_source"]["noise"] == pytest.approx(2.0)
    assert document["median_dn_by_source"]["focus"] == pytest.approx(0.0, abs=1e-6)
    assert document["not_known"] == []
    assert document["stated_model_error"] == "model"


def test_what_is_not_known_is_said(
    command: Command, waves: Path, psf_file: Path, tmp_path: Path
) -> None:
    out, err = tmp_path / "far.tif", tmp_path / "err.tif"
    words = ("--zoom", 1.5, "--psf", psf_file, "--out", out, "--uncertainty", err)
    done = command.done("simulate", waves, *words)
    assert "reference's noise is unknown" in done.err
    assert "--focus-scatter" in done.err
    assert "standard error" in done.out
    assert tifffile.imread(err).dtype == np.float32


def test_focus_in_a_wave_is_the_closed_form(
    command: Command, waves: Path, known_psf: Path, tmp_path: Path
) -> None:
    # A wave of amplitude a and w radians a follow-up pixel is s w^2 a / 2 off where it peaks by the
    # follow-up's focus, and z^2 times less by the reference's; (0.4, 0.3) have the length 0.5.
    out, err = tmp_path / "far.tif", tmp_path / "err.tif"
    words = ("--psf", known_psf, "--out", out, "--uncertainty", err, "--focus-scatter", 0.05)
    command.done("simulate", waves, "--zoom", 1.5, *words, "--model", "matched", "--json")
    far = tifffile.imread(out)[10:-10, 10:-10].astype(float) - 500
    amplitude = np.abs(far).max()
    expected = 0.5 * 0.05 * (0.5 * 1.5) ** 2 * amplitude * np.sqrt(1 + 1.5**-4)
    again = standoff.simulate(
        waves,
        zoom=1.5,
        psf=known_psf,
        model="matched",
        uncertainty=standoff.UncertaintyOptions(focus_scatter_px2=0.05),
    )
    assert again.uncertainty is not None
    focus = again.uncertainty.pixels.focus
    assert focus is not None
    assert np.sqrt(focus[10:-10, 10:-10].max()) == pytest.approx(expected, rel=0.01)
    np.testing.assert_array_equal(again.uncertainty.err, tifffile.imread(err))


def test_another_pose_has_no_error_where_it_shows_nothing(
    command: Command, waves: Path, known_psf: Path, tmp_path: Path
) -> None:
    pose, out, err = tmp_path / "H.json", tmp_path / "far.tif", tmp_path / "err.tif"
    pose.write_text(IDENTITY.replace("[1.5, 0, 5]", "[1.5, 0, 60]"))
    words = ("--psf", known_psf, "--out", out, "--uncertainty", err, "--reference-noise", 1)
    command.done("simulate", waves, "--homography", pose, *words, "--focus-scatter", 0.02)
    stored = tifffile.imread(err)
    assert np.isnan(stored[:, 45:]).all()
    assert np.isfinite(stored[:, :35]).all()


def test_added_noise_is_part_of_the_error(waves: Path, known_psf: Path, noise_file: Path) -> None:
    options = standoff.UncertaintyOptions()
    found = standoff.simulate(
        waves, zoom=2, psf=known_psf, noise=noise_file, uncertainty=options
    ).uncertainty
    assert found is not None
    added, left = found.pixels.added_noise, found.pixels.noise
    assert added is not None
    assert left is not None
    # Together they are the noise of a capture, which at 500 DN is nearly the same everywhere.
    whole = np.sqrt(np.median(added + left))
    assert whole > 1.5 * np.sqrt(np.median(left))
    assert found.to_json()["median_dn_by_source"]["added_noise"] > 0


def test_an_uncertainty_that_was_not_asked_for_is_not_written(
    waves: Path, known_psf: Path, tmp_path: Path
) -> None:
    found = standoff.simulate(waves, zoom=1.5, psf=known_psf)
    assert found.uncertainty is None
    with pytest.raises(standoff.ArgumentError):
        found.write_uncertainty(tmp_path / "err.tif")
