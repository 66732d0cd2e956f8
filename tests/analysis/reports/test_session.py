from pathlib import Path

import pytest

from acquisition.session import Session
from analysis.reports._bench import versions
from analysis.reports._page import CONVENTION
from analysis.reports._session import SessionNotes, session_report, with_curves
from analysis.validation._document import ExcludedCapture, Validation
from calibration.psf import PsfCalibration
from calibration.sharpness import SharpnessLimits
from tests.acquisition.session_fixtures import whole_session
from tests.analysis.html_page import Page


@pytest.fixture(scope="module")
def page(session: Session, psf: PsfCalibration, validation: Validation) -> Page:
    return Page(session_report(session, psf, validation).html())


@pytest.mark.slow
def test_the_report_has_all_its_parts_in_order(page: Page) -> None:
    assert page.headings == [
        "Session small",
        "Captures",
        "Edges",
        "Point spread function",
        "Edge profiles",
        "Width by angle and height",
        "From centre to corner",
        "Curves of the edges",
        "Simulated against captured follow-ups",
        "Noise",
        "Stage",
        "All edges",
        "Where this comes from",
    ]


def test_the_report_is_one_file_with_its_figures_in_it(page: Page) -> None:
    assert page.fetched == []
    # MTF, transfer, three profiles, widths by angle and height, curves of 24 edges, five a figure,
    # metrics by zoom, noise, stage; photographs as PNG.
    assert page.tags.count("svg") == 15
    assert page.tags.count("img") == 5


def test_the_report_names_operator_session_devices_and_versions(
    page: Page, session: Session
) -> None:
    assert "series, captured by Zoë" in page.texts
    assert "27 of 27 planned; complete." in page.texts
    for name, version in versions():
        assert name in page.texts
        assert version in page.texts
    assert "C1" in page.texts


def test_the_figures_of_the_report_are_those_of_the_results(
    page: Page, psf: PsfCalibration, validation: Validation
) -> None:
    assert f"{psf.sigma_x_px:.4f} px" in page.texts
    means = validation.means("followup-grid")
    assert list(means) == ["bicubic", "paper", "matched", "lmmse"]
    for mean in means.values():
        assert f"{mean.mse_dn2:.2f}" in page.texts
    assert f"MSE {means['matched'].mse_dn2:.2f}" in page.texts
    assert "leaves" in page.text
    assert "150.002" in page.texts


@pytest.mark.slow
def test_a_session_without_results_reports_its_captures(tmp_path: Path) -> None:
    whole_session(tmp_path / "s")
    page = Page(session_report(Session(tmp_path / "s"), None, None).html())
    assert page.headings == ["Session small", "Captures", "Stage", "Where this comes from"]
    assert "6 of 6 planned; complete." in page.texts


@pytest.mark.slow
def test_edges_of_other_photographs_are_left_out_of_the_drawings(
    session: Session, psf: PsfCalibration
) -> None:
    foreign = psf.edges[0].model_copy(update={"image": "elsewhere/photo.tif"})
    mixed = psf.model_copy(update={"edges": [foreign, *psf.edges[:1]]})
    page = Page(session_report(session, mixed, None).html())
    # The list of all edges names it, no figure is drawn of it.
    assert "elsewhere/photo.tif" in page.texts
    assert page.tags.count("img") == 1
    assert "1 edges of this psf.json are on photographs that are not available here" in page.text


@pytest.mark.slow
def test_what_is_left_out_stands_first_with_its_reason(
    session: Session, validation: Validation
) -> None:
    other = ExcludedCapture(capture=7, target="moss", height_mm=120.0, reason="no common detail")
    lame = validation.model_copy(update={"excluded": (other,), "remarks": ("it is dim",)})
    page = Page(
        session_report(
            session, None, lame, SessionNotes(remarks=("The PSF: sigma_y_px is null.",))
        ).html()
    )
    assert page.headings[:3] == ["Session small", "Left out", "Captures"]
    assert "The PSF: sigma_y_px is null." in page.texts
    assert f"Left out: {other.text}." in page.texts
    assert "Remark: it is dim." in page.texts


@pytest.mark.slow
def test_a_session_with_a_psf_has_the_front_page_of_a_calibration(
    session: Session, psf: PsfCalibration
) -> None:
    limits = SharpnessLimits.model_validate({"mtf50": {"min_cy_per_px": 0.9}})
    judged = psf.judged(limits, "l.toml")
    page = Page(session_report(session, judged, None, SessionNotes(warnings=("beware",))).html())
    for text in ("fail", "1 limit of l.toml: 1 failed.", "photographed", "lens", "beware"):
        assert text in page.texts
    assert page.headings[1:3] == ["Limits", "Captures"]
    assert CONVENTION.replace(" %", "\u00a0%") in page.texts


def test_the_curves_of_a_sessions_edges_are_those_that_were_calibrated(
    session: Session, psf: PsfCalibration
) -> None:
    assert all(edge.esfr is None for edge in psf.edges)
    known = with_curves(psf, session)
    for edge in known.edges:
        assert (edge.esfr is None) == (edge.esfr_mtf50_cy_per_px is None)
        if edge.esfr is not None:
            assert edge.esfr.mtf50_cy_per_px == pytest.approx(edge.esfr_mtf50_cy_per_px, rel=1e-6)
    assert any(edge.esfr is not None for edge in known.edges)


def test_an_edge_that_does_not_come_back_stays_without_a_curve(
    session: Session, psf: PsfCalibration
) -> None:
    edge = next(edge for edge in psf.edges if edge.esfr_mtf50_cy_per_px is not None)
    assert edge.esfr_mtf50_cy_per_px is not None
    other = {"esfr_mtf50_cy_per_px": 1.1 * edge.esfr_mtf50_cy_per_px}
    changed = psf.model_copy(update={"edges": (edge.model_copy(update=other),)})
    assert with_curves(changed, session).edges[0].esfr is None
    mosaic = psf.model_copy(update={"channels": {"green": psf}})
    assert all(edge.esfr is None for edge in with_curves(mosaic, session).edges)
