import json
import os
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.errors import PsfFileError
from calibration.files import PSF_SCHEMA, psf_document, read_psf, write_psf
from calibration.psf.calibration import PsfCalibration, calibrate_psf
from tests.calibration.edge_photographs import EIGHT_NORMALS_DEG, photographs

DOCUMENTED_KEYS = {
    "schema",
    "sigma_x_px",
    "sigma_y_px",
    "rho",
    "covariance_px2",
    "sigma_x_err_px",
    "sigma_y_err_px",
    "rho_err",
    "optical_sigma_x_px",
    "optical_sigma_y_px",
    "optical_sigma_x_err_px",
    "optical_sigma_y_err_px",
    "optical_rho",
    "optical_rho_err",
    "optical_covariance_px2",
    "field",
    "method",
    "edges",
}
DOCUMENTED_EDGE_KEYS = {
    "image",
    "capture",
    "height_mm",
    "x_px",
    "y_px",
    "angle_deg",
    "orientation",
    "length_px",
    "snr",
    "sigma_px",
    "sigma_err_px",
    "optical_sigma_px",
    "optical_sigma_err_px",
    "mtf50_cy_per_px",
    "chi2_reduced",
    "flags",
    "esfr_mtf50_cy_per_px",
    "esfr_mtf50_err_cy_per_px",
    "esfr_mtf20_cy_per_px",
    "contrast",
    "roughness_px",
    "clipped_fraction",
}


@pytest.fixture(scope="module")
def calibration() -> PsfCalibration:
    return calibrate_psf(photographs(EIGHT_NORMALS_DEG))


def stored(path: Path, **content: Any) -> Path:
    path.write_text(json.dumps({"schema": PSF_SCHEMA, **content}), encoding="utf-8")
    return path


def test_what_was_written_is_read_back(tmp_path: Path, calibration: PsfCalibration) -> None:
    path = tmp_path / "psf.json"
    write_psf(path, calibration)
    psf = read_psf(path)
    for name in ("sigma_x_px", "sigma_y_px", "optical_sigma_x_px", "optical_sigma_y_px"):
        estimate = getattr(calibration, name)
        assert getattr(psf, name) == estimate.value
        assert getattr(psf, name.replace("_px", "_err_px")) == estimate.err
        assert psf.intervals_95[name] == (estimate.low, estimate.high)
    assert calibration.rho is not None
    assert (psf.rho, psf.rho_err) == (calibration.rho.value, calibration.rho.err)
    assert calibration.covariance_px2 is not None
    np.testing.assert_array_equal(psf.covariance_px2, calibration.covariance_px2)
    assert psf.method == "all-angles"
    for read, edge in zip(psf.edges, calibration.edges, strict=True):
        assert (read.image, read.orientation) == (edge.image, edge.orientation)
        assert (read.sigma_px, read.sigma_err_px) == (edge.fit.sigma_px, edge.fit.sigma_err_px)
        assert read.mtf50_cy_per_px == edge.mtf50_cy_per_px
        assert tuple(read.flags) == edge.flags


def test_every_documented_key_is_there(tmp_path: Path, calibration: PsfCalibration) -> None:
    path = tmp_path / "psf.json"
    write_psf(path, calibration)
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document.keys() >= DOCUMENTED_KEYS
    assert all(edge.keys() == DOCUMENTED_EDGE_KEYS for edge in document["edges"])
    assert document["schema"] == "standoff.psf/1"


def test_what_one_edge_does_not_determine_is_null() -> None:
    document = psf_document(calibrate_psf(photographs([4.0])))
    assert document.keys() >= DOCUMENTED_KEYS
    assert document["sigma_x_px"] is not None
    for name in ("sigma_y_px", "sigma_y_err_px", "rho", "rho_err", "covariance_px2", "field"):
        assert document[name] is None
    assert "sigma_y_px" not in document["intervals_95"]


def test_the_covariance_belongs_to_the_widths(calibration: PsfCalibration) -> None:
    document = psf_document(calibration)
    for prefix in ("", "optical_"):
        x, y = document[f"{prefix}sigma_x_px"], document[f"{prefix}sigma_y_px"]
        xy = document[f"{prefix}rho"] * x * y
        np.testing.assert_allclose(
            document[f"{prefix}covariance_px2"], [[x * x, xy], [xy, y * y]], rtol=1e-12
        )


def test_a_file_with_the_total_values_alone_is_accepted(tmp_path: Path) -> None:
    psf = read_psf(stored(tmp_path / "psf.json", sigma_x_px=0.8, sigma_y_px=0.7, rho=0.2))
    total = psf.total_psf("psf.json")
    assert (total.sigma_x_px, total.sigma_y_px, total.rho) == (0.8, 0.7, 0.2)
    assert psf.optical_sigma_x_px is None
    assert psf.edges == []


def test_a_correlation_that_is_not_given_is_none(tmp_path: Path) -> None:
    psf = read_psf(stored(tmp_path / "psf.json", sigma_x_px=0.8, sigma_y_px=0.7))
    assert psf.total_psf("psf.json").rho == 0.0


@pytest.mark.parametrize(
    ("given", "missing", "edges"),
    [("sigma_x_px", "sigma_y_px", "horizontal"), ("sigma_y_px", "sigma_x_px", "vertical")],
)
def test_a_null_width_is_refused_by_name_with_the_edges_it_takes(
    tmp_path: Path, given: str, missing: str, edges: str
) -> None:
    psf = read_psf(stored(tmp_path / "psf.json", **{given: 0.8, missing: None}))
    with pytest.raises(PsfFileError, match=rf"lens\.json: {missing} is null.* {edges} edges"):
        psf.total_psf("lens.json")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"sigma_x_px": -0.5, "sigma_y_px": 0.5}, "sigma_x_px must be positive"),
        ({"sigma_x_px": 0.5, "sigma_y_px": 0.5, "rho": 1.0}, "rho must lie inside"),
    ],
)
def test_values_that_no_psf_has_are_refused(
    tmp_path: Path, content: dict[str, float], message: str
) -> None:
    psf = read_psf(stored(tmp_path / "psf.json", **content))
    with pytest.raises(PsfFileError, match=rf"lens\.json: {message}"):
        psf.total_psf("lens.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a psf.json"),
        ("\ufeff{}", "not a psf.json"),
        ("[1, 2]", "schema is None, expected 'standoff.psf/1'"),
        ('{"schema": "standoff.noise/1"}', "schema is 'standoff.noise/1'"),
        ('{"schema": "standoff.psf/1", "sigma_x_px": "wide"}', "sigma_x_px: Input should be"),
        ('{"schema": "standoff.psf/1", "edges": [{"image": "a"}]}', r"edges\.0\.capture"),
    ],
)
def test_what_is_no_psf_json_is_refused_with_its_name(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "other.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PsfFileError, match=rf"other\.json: {message}"):
        read_psf(path)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "photo.tif"
    path.write_bytes(b"II*\x00\xff\xfe\x80")
    with pytest.raises(PsfFileError, match=r"photo\.tif: not a psf\.json"):
        read_psf(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PsfFileError, match=r"cannot read .*none\.json: No such file"):
        read_psf(tmp_path / "none.json")


def test_a_path_that_cannot_be_written_is_named(
    tmp_path: Path, calibration: PsfCalibration
) -> None:
    with pytest.raises(PsfFileError, match=r"cannot write .*psf\.json: No such file"):
        write_psf(tmp_path / "nowhere" / "psf.json", calibration)
    (tmp_path / "folder").mkdir()
    with pytest.raises(PsfFileError, match=r"cannot write .*folder: "):
        write_psf(tmp_path / "folder", calibration)


def test_a_full_disk_leaves_the_old_file_as_it_was(
    tmp_path: Path, calibration: PsfCalibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "psf.json"
    write_psf(path, calibration)
    before = path.read_bytes()

    def no_space(descriptor: int) -> None:
        # fsync of the new file fails as on a full disk; that of a directory is not reached.
        assert stat.S_ISREG(os.fstat(descriptor).st_mode)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(PsfFileError, match="No space left on device"):
        write_psf(path, calibrate_psf(photographs([4.0])))
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["psf.json"]
