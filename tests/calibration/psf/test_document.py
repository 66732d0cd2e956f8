"""psf.json: what the calibration fills is what is written, and what is read."""

import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.documents import json_object
from calibration.errors import PsfFileError
from calibration.files import read_psf, write_psf
from calibration.psf import (
    CameraIdentity,
    ColourPsf,
    Estimate,
    FieldFit,
    PairWidths,
    PsfCalibration,
    PsfEstimates,
    PsfOrigin,
    psf_of_images,
)
from calibration.psf._document import PSF_SCHEMA, PsfWidths
from simulation.arrays import FloatArray
from tests.calibration.edge_photographs import EIGHT_NORMALS_DEG, photographs
from tests.calibration.known import known

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
    "mtf50_err_cy_per_px",
    "mtf50_lw_per_ph",
    "mtf50_lp_per_mm",
    "esfr_mtf50_lw_per_ph",
    "esfr_mtf50_lp_per_mm",
    "red_shift_px",
    "red_shift_err_px",
    "blue_shift_px",
    "blue_shift_err_px",
    "chi2_reduced",
    "flags",
    "esfr_mtf50_cy_per_px",
    "esfr_mtf50_err_cy_per_px",
    "esfr_mtf20_cy_per_px",
    "esfr_missing",
    "contrast",
    "roughness_px",
    "clipped_fraction",
}


@pytest.fixture(scope="module")
def calibration() -> PsfCalibration:
    return psf_of_images(photographs(EIGHT_NORMALS_DEG))


def stored(path: Path, **content: Any) -> Path:
    path.write_text(json.dumps({"schema": PSF_SCHEMA, **content}), encoding="utf-8")
    return path


def refusal(path: Path) -> PsfFileError:
    with pytest.raises(PsfFileError) as refused:
        read_psf(path)
    assert refused.value.source == str(path)
    return refused.value


def test_what_was_written_is_read_back(tmp_path: Path, calibration: PsfCalibration) -> None:
    path = tmp_path / "psf.json"
    origin = PsfOrigin(camera=CameraIdentity(serial="S1"), region="centre")
    write_psf(path, calibration.with_origin(origin))
    psf = read_psf(path)
    assert json_object(psf) == json_object(calibration.with_origin(origin))
    for name in ("sigma_x_px", "sigma_y_px", "rho"):
        assert getattr(psf.total, name) == getattr(calibration.total, name)
        assert getattr(psf.optical, name) == getattr(calibration.optical, name)
    np.testing.assert_array_equal(covariance_of(psf.total), covariance_of(calibration.total))
    assert psf.method == "all-angles"
    assert psf.camera == CameraIdentity(serial="S1")
    assert (psf.region, psf.channel, psf.captured_utc) == ("centre", None, None)


def covariance_of(psf: PsfEstimates) -> FloatArray:
    assert psf.covariance_px2 is not None
    return psf.covariance_px2


def test_every_documented_key_is_there(tmp_path: Path, calibration: PsfCalibration) -> None:
    path = tmp_path / "psf.json"
    write_psf(path, calibration)
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document.keys() >= DOCUMENTED_KEYS
    assert all(edge.keys() == DOCUMENTED_EDGE_KEYS for edge in document["edges"])
    assert next(iter(document.items())) == ("schema", "standoff.psf/1")


def test_what_one_edge_does_not_determine_is_null() -> None:
    document = json_object(psf_of_images(photographs([4.0])))
    assert document.keys() >= DOCUMENTED_KEYS
    assert document["sigma_x_px"] is not None
    for name in ("sigma_y_px", "sigma_y_err_px", "rho", "rho_err", "covariance_px2", "field"):
        assert document[name] is None
    assert "sigma_y_px" not in document["intervals_95"]


def test_the_covariance_belongs_to_the_widths(calibration: PsfCalibration) -> None:
    document = json_object(calibration)
    for prefix in ("", "optical_"):
        x, y = document[f"{prefix}sigma_x_px"], document[f"{prefix}sigma_y_px"]
        xy = document[f"{prefix}rho"] * x * y
        np.testing.assert_allclose(
            document[f"{prefix}covariance_px2"], [[x * x, xy], [xy, y * y]], rtol=1e-12
        )


@given(
    value=st.floats(0.1, 9.0),
    err=st.floats(0.0, 1.0),
    low=st.floats(0.0, 9.0),
    high=st.floats(0.0, 9.0),
)
def test_an_estimate_comes_out_as_it_was_put_in(
    value: float, err: float, low: float, high: float
) -> None:
    width = Estimate(value=value, err=err, interval_95=(low, high))
    total = PsfEstimates(sigma_x_px=width, sigma_y_px=None, rho=None, covariance_px2=None)
    for psf in (PsfWidths.of(total, None), PsfCalibration.of(total, total)):
        assert psf.total.sigma_x_px == width
        assert psf.total.sigma_y_px is None
    assert psf.optical.sigma_x_px == width
    assert PsfWidths.of(total, None).optical.sigma_x_px is None


def test_an_error_without_an_interval_gives_that_of_a_normal_distribution() -> None:
    psf = PsfCalibration(sigma_x_px=0.8, sigma_x_err_px=0.01)
    width = known(psf.total.sigma_x_px)
    # 1.96 standard errors either way.
    assert (width.low, width.high) == pytest.approx((0.7804, 0.8196), abs=1e-5)
    assert PsfCalibration(sigma_x_px=0.8).total.sigma_x_px is None


def test_what_a_file_does_not_hold_is_no_key_of_it(calibration: PsfCalibration) -> None:
    assert calibration.edges[0].esfr is not None
    assert "esfr" not in calibration.edges[0].model_dump()
    colour = ColourPsf.of(calibration.total, calibration.optical, edge_count=8)
    assert json_object(colour).keys() == PsfWidths.model_fields.keys()


def test_a_file_with_the_total_values_alone_is_accepted(tmp_path: Path) -> None:
    psf = read_psf(stored(tmp_path / "psf.json", sigma_x_px=0.8, sigma_y_px=0.7, rho=0.2))
    total = psf.total_psf("psf.json")
    assert (total.sigma_x_px, total.sigma_y_px, total.rho) == (0.8, 0.7, 0.2)
    assert psf.optical_sigma_x_px is None
    assert psf.edges == ()


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
    with pytest.raises(PsfFileError) as refused:
        psf.total_psf("lens.json")
    assert (refused.value.source, refused.value.key) == ("lens.json", missing)
    assert f"{edges} edges" in str(refused.value)


@pytest.mark.parametrize(
    "content",
    [
        {"sigma_x_px": -0.5, "sigma_y_px": 0.5},
        {"sigma_x_px": 0.5, "sigma_y_px": 0.5, "rho": 1.0},
    ],
)
def test_values_that_no_psf_has_are_refused(tmp_path: Path, content: dict[str, float]) -> None:
    psf = read_psf(stored(tmp_path / "psf.json", **content))
    with pytest.raises(PsfFileError) as refused:
        psf.total_psf("lens.json")
    assert refused.value.source == "lens.json"
    assert isinstance(refused.value.__cause__, ValueError)


def test_a_field_that_is_no_psf_is_refused() -> None:
    field = FieldFit(width_px=100, height_px=80, coefficients_px2=((-1.0,), (0.0,), (1.0,)))
    with pytest.raises(PsfFileError) as refused:
        PsfCalibration(field=field).total_field("lens.json")
    assert (refused.value.source, refused.value.key) == ("lens.json", "field")


@pytest.mark.parametrize(
    ("content", "key"),
    [
        ({"sigma_x_px": "wide"}, "sigma_x_px"),
        ({"covariance_px2": [[1.0]]}, "covariance_px2.0.1"),
        ({"edges": [{"image": "a"}]}, "edges.0.capture"),
    ],
)
def test_what_is_no_psf_json_is_refused_with_the_key(
    tmp_path: Path, content: dict[str, object], key: str
) -> None:
    assert refusal(stored(tmp_path / "other.json", **content)).key == key


def test_a_missing_file_and_one_that_cannot_be_written_are_named(
    tmp_path: Path, calibration: PsfCalibration
) -> None:
    refusal(tmp_path / "none.json")
    with pytest.raises(PsfFileError) as refused:
        write_psf(tmp_path / "nowhere" / "psf.json", calibration)
    assert refused.value.source == str(tmp_path / "nowhere" / "psf.json")


def test_a_result_is_one_line_at_the_prompt(calibration: PsfCalibration) -> None:
    shown = repr(calibration)
    assert len(shown) < 160
    assert "\n" not in shown
    assert str(calibration) == shown
    for name in ("sigma_x_px", "sigma_y_px", "rho"):
        assert str(getattr(calibration.total, name)) in shown
    assert "8 of 8 edges, all-angles" in shown
    assert len(repr(calibration.edges[0])) < 120
    pair = PairWidths(
        near="a", far="b", zoom=2.0, sigma_x_px=1, sigma_x_err_px=1, sigma_y_px=1, sigma_y_err_px=1
    )
    bare = PsfCalibration(sigma_x_px=0.8, pairs=(pair,))
    assert repr(bare) == "PsfCalibration(sigma_x 0.8000 px; 1 pair)"
    assert repr(PsfCalibration()) == "PsfCalibration()"


def test_a_notebook_shows_a_table_in_which_nothing_is_markup(calibration: PsfCalibration) -> None:
    class Cells(HTMLParser):
        text = ""

        def handle_data(self, data: str) -> None:
            self.text += f"{data}|"

        def handle_starttag(self, tag: str, attrs: object) -> None:
            assert tag in {"table", "caption", "tr", "th", "td"}

    cells = Cells()
    cells.feed(calibration.model_copy(update={"method": "<script>"})._repr_html_())
    assert "<script>" in cells.text
    assert str(calibration.optical.rho) in cells.text
