import numpy as np
import pytest

from acquisition.files import Provenance
from acquisition.session._reader import Session
from analysis.reports import (
    calibration_front,
    calibration_sections,
    calibration_verdicts,
    edge_table_section,
    history_document,
    history_sections,
    ordered_history,
    plot_history,
    verdict_section,
)
from analysis.reports._psf_field import field_section, widths_section
from calibration.edges import EdgeMeasurement
from calibration.psf import CameraIdentity, FieldFit, PsfCalibration
from calibration.sharpness import SharpnessLimits, reported_mtf50
from simulation.arrays import Float32Array, FloatArray
from tests.calibration.sharpness.edges import edge_of


def test_the_front_states_what_the_photographs_were_taken_with() -> None:
    psf = PsfCalibration(
        photograph={
            "camera": "Nikon Z 9",
            "lens": "50 mm f/1.8",
            "f_number": 4.0,
            "exposure_s": 0.004,
            "taken": "2026-11-22 10:00:00",
        },
        provenance=Provenance(
            version="1", created="2026-11-22T12:00:00Z", command="c", encoding="srgb"
        ),
        picture_width_px=780,
        picture_height_px=580,
        pixel_pitch_um=4.35,
        pixel_pitch_from="EXIF",
    )
    facts = dict(calibration_front(psf, ()).facts)
    assert facts == {
        "photographed": "2026-11-22 10:00",
        "measured": "2026-11-22 12:00 UTC",
        "camera": "Nikon Z 9",
        "lens": "50 mm f/1.8",
        "focal length": "not stated",
        "f-number": "f/4",
        "exposure": "1/250 s",
        "ISO": "not stated",
        "encoding": "srgb",
        "picture": "780 x 580 px",
        "pixel pitch": "4.35 µm (EXIF)",
    }


def test_the_camera_of_a_session_is_named_with_its_serial_number() -> None:
    camera = CameraIdentity(vendor="AVT", model="Manta", serial="C1")
    facts = dict(calibration_front(PsfCalibration(camera=camera), ()).facts)
    assert facts["camera"] == "AVT Manta C1"
    assert facts["pixel pitch"] == "unknown"


def test_without_limits_there_is_no_verdict_and_no_table_of_limits() -> None:
    front = calibration_front(PsfCalibration(), ("beware",))
    assert (front.outcome, front.warnings) == ("none", ("beware",))
    assert verdict_section(PsfCalibration()) is None


@pytest.mark.parametrize(("bound", "outcome"), [(0.1, "pass"), (0.9, "fail")])
def test_the_verdict_counts_its_limits_and_tabulates_each_with_its_figure(
    bound: float, outcome: str
) -> None:
    limits = SharpnessLimits.model_validate(
        {"mtf50": {"min_cy_per_px": bound}, "lateral_colour": {"max_px": 1.0}}
    )
    psf = PsfCalibration(edges=(edge_of(),)).judged(limits, "l.toml")
    front = calibration_front(psf, ())
    assert front.outcome == ("fail" if outcome == "fail" else "unsure")
    words = {"pass": "1 passed, 1 unsure", "fail": "1 failed, 1 unsure"}
    assert front.verdict == f"2 limits of l.toml: {words[outcome]}."
    section = verdict_section(psf)
    assert section is not None
    mtf50, colour = section.tables[0].rows
    assert mtf50[:3] == ("mtf50.min_cy_per_px", f"at least {bound:g} cy/px", "0.2700")
    assert mtf50[4] == outcome
    assert colour[2:5] == ("not measured", "", "unsure")


def test_the_verdict_gives_widths_with_intervals_and_the_edges_that_count(
    psf: PsfCalibration,
) -> None:
    middle, softest, sharpest, x, y, rho, edges = calibration_verdicts(psf)
    values = sorted(reported_mtf50(edge).cy_per_px for edge in psf.edges)
    assert middle.value == f"{np.median(values):.3f} cy/px"
    assert softest.value == f"{values[0]:.3f} cy/px"
    assert sharpest.value == f"{values[-1]:.3f} cy/px"
    assert x.value == f"{psf.sigma_x_px:.4f} px"
    low, high = psf.intervals_95["sigma_x_px"]
    assert x.remark == f"95 %: {low:.4f} to {high:.4f}"
    assert y.name == "total sigma y"
    assert rho.value == f"{psf.rho:.4f}"
    assert (edges.value, edges.remark) == (str(len(psf.edges)), f"of {len(psf.edges)} found")


def test_what_is_null_is_not_determined_and_rejected_edges_do_not_count(
    psf: PsfCalibration,
) -> None:
    flagged = [psf.edges[0].model_copy(update={"flags": ["saturated"]}), *psf.edges[1:]]
    partial = psf.model_copy(update={"sigma_y_px": None, "rho": None, "edges": flagged})
    names = [verdict.name for verdict in calibration_verdicts(partial)]
    assert "total sigma x" in names
    assert not {"total sigma y", "correlation rho"} & set(names)
    assert calibration_verdicts(partial)[-1].value == str(len(psf.edges) - 1)


def test_the_headline_of_one_edge_is_its_mtf50_in_every_known_unit() -> None:
    edge = edge_of(
        esfr_mtf50_cy_per_px=0.25, esfr_mtf50_err_cy_per_px=0.01, mtf50_lw_per_ph=0.27 * 2 * 480
    )
    one = PsfCalibration(edges=(edge,), picture_height_px=480, pixel_pitch_um=5.0)
    headline = calibration_verdicts(one)[0]
    # By hand: 2 * 0.25 * 480 = 240 LW/PH; 0.25 / 5 um = 50 lp/mm; 1.96 * 4 % = 7.84 %.
    assert headline.value == "0.250 cy/px"
    assert headline.remark == "0.2500 ± 0.0196 cy/px; 240.0 ± 18.8 LW/PH; 50.00 ± 3.92 lp/mm"


def test_the_median_of_many_edges_has_its_uncertainty_in_every_unit() -> None:
    edges = tuple(
        edge_of(
            esfr_mtf50_cy_per_px=0.25,
            esfr_mtf50_err_cy_per_px=0.01,
            mtf50_lw_per_ph=0.27 * 2 * 480,
            x_px=x_px,
        )
        for x_px in (10.0, 20.0)
    )
    two = PsfCalibration(edges=edges, picture_height_px=480, pixel_pitch_um=5.0)
    headline = calibration_verdicts(two)[0]
    # The error of a mean of two: 1.96 * 0.01 / sqrt(2) = 0.01386, 5.54 % of the value.
    assert headline.remark == "0.2500 ± 0.0139 cy/px; 240.0 ± 13.3 LW/PH; 50.00 ± 2.77 lp/mm"


def test_what_the_edges_do_not_determine_is_said_in_one_line() -> None:
    section = calibration_sections(PsfCalibration(sigma_x_px=0.8), lambda _: np.zeros((2, 2)))[0]
    assert [row[0] for row in section.tables[0].rows] == ["sigma x / px"]
    assert section.text[-1] == "Not determined by these edges: sigma y, rho."


def test_a_psf_of_total_values_alone_has_a_report_too() -> None:
    def no_image(edge: EdgeMeasurement) -> FloatArray:
        raise AssertionError(edge)

    [section] = calibration_sections(PsfCalibration(sigma_x_px=0.8, sigma_y_px=0.7), no_image)
    assert section.tables[0].rows[0] == ("sigma x / px", "0.8000", "", "not determined", "")
    assert len(section.figures) == 1
    assert calibration_verdicts(PsfCalibration(sigma_x_px=0.8))[0].remark == ""


@pytest.mark.slow
def test_photographs_of_different_directions_are_shown_and_each_orientation_has_a_profile(
    psf: PsfCalibration, session: Session
) -> None:
    records = {record.file: record for record in session.records}
    read: list[str] = []

    def load(edge: EdgeMeasurement) -> Float32Array:
        read.append(edge.image)
        return session.load(records[edge.image]).mean_dn

    sections = {section.title: section for section in calibration_sections(psf, load)}
    assert list(sections) == [
        "Edges",
        "Point spread function",
        "Edge profiles",
        "Width by angle and height",
        "From centre to corner",
    ]
    edges = sections["Edges"]
    assert len(edges.figures) == 4
    assert f"4 of {len({e.image for e in psf.edges})} photographs are shown." in edges.text
    assert sections["Edges"].figures_of_first_row == 2
    shown = [figure.caption.split()[2] for figure in edges.figures]
    angles = {name: next(e.angle_deg for e in psf.edges if e.image == name) for name in shown}
    assert len({round(angle) for angle in angles.values()}) == 4
    captions = [figure.caption for figure in sections["Edge profiles"].figures]
    assert [caption.split()[2] for caption in captions] == ["vertical", "horizontal", "diagonal"]
    assert len(sections["Width by angle and height"].figures) == 2
    assert set(read) <= set(records)


def test_the_table_of_edges_gives_widths_with_errors_and_remarks(psf: PsfCalibration) -> None:
    first = psf.edges[0].model_copy(
        update={
            "image": "captures/0001.tif",
            "flags": ["too_short", "jpeg"],
            "snr": None,
            "chi2_reduced": None,
            "optical_sigma_px": None,
        }
    )
    section = edge_table_section(psf.model_copy(update={"edges": [first]}))
    assert section.is_folded
    rows = []
    for table in section.tables:
        [row] = table.rows
        assert len(row) == len(table.columns)
        rows.append(dict(zip(table.columns, row, strict=True)))
    sharpness, quality = rows
    assert " " not in sharpness["edge"]  # no line breaks within a position
    assert sharpness["sigma / px"] == f"{first.sigma_px:.4f} ± {1.96 * first.sigma_err_px:.4f}"
    assert sharpness["MTF50 / (cy/px)"].startswith(f"{first.esfr_mtf50_cy_per_px:.4f} ± ")
    assert sharpness["optical sigma / px"] == "not resolved"
    assert quality["SNR"] == "over 9999"
    assert quality["reduced chi²"] == ""
    assert quality["contrast"] == f"{first.contrast:.2f}"
    assert quality["remarks"] == "too short, jpeg"
    other = psf.edges[1].model_copy(update={"image": "captures/0002.tif"})
    two = edge_table_section(psf.model_copy(update={"edges": [first, other]}))
    titles = [row for row in two.tables[0].rows if len(row) == 1]
    assert titles == [("captures/0001.tif",), ("captures/0002.tif",)]
    assert len(two.tables[0].rows) == 4


def test_a_remark_on_all_edges_is_said_once(psf: PsfCalibration) -> None:
    edges = [
        psf.edges[0].model_copy(update={"flags": ("jpeg", "non_gaussian")}),
        psf.edges[0].model_copy(update={"flags": ("jpeg",)}),
    ]
    section = edge_table_section(psf.model_copy(update={"edges": edges}))
    assert "Remarks on all edges: jpeg." in section.text
    assert [row[-1] for row in section.tables[1].rows] == ["non gaussian", ""]


def test_a_long_list_of_edges_is_cut_and_says_so(psf: PsfCalibration) -> None:
    many = psf.model_copy(update={"edges": psf.edges[:1] * 230})
    section = edge_table_section(many)
    assert len(section.tables[0].rows) == 200
    assert "30 more edges are in psf.json." in section.text
    assert len(section.tables) == 1
    assert not section.is_wide


@pytest.mark.slow
def test_edges_of_foreign_photographs_are_counted_and_said_to_be_left_out(
    psf: PsfCalibration,
) -> None:
    def no_image(edge: EdgeMeasurement) -> FloatArray:
        raise AssertionError(edge)

    sections = {s.title: s for s in calibration_sections(psf, no_image, frozenset())}
    assert sections["Edges"].figures == ()
    assert (
        f"{len(psf.edges)} edges of this psf.json are on photographs" in sections["Edges"].text[0]
    )
    assert "Edge profiles" not in sections
    assert sections["Width by angle and height"].figures


def test_a_field_that_is_none_is_left_out_with_its_fault(psf: PsfCalibration) -> None:
    bad = FieldFit(width_px=100, height_px=80, coefficients_px2=((-1.0,), (0.0,), (1.0,)))
    section = field_section(psf.model_copy(update={"field": bad}))
    assert section is not None
    assert section.text[0].startswith("Left out: psf.json: field: the covariance is not positive")
    good = FieldFit(
        width_px=100,
        height_px=80,
        coefficients_px2=((0.25,), (0.0,), (0.16,)),
        p_value=1e-5,
        worst_err=0.01,
    )
    section = field_section(psf.model_copy(update={"field": good}))
    assert section is not None
    assert section.tables[0].rows[0] == ("centre", "0.5000", "0.4000", "+0.000")
    assert "p = 1e-05" in section.text[0]


@pytest.mark.slow
def test_a_drift_of_the_focus_is_said_in_words(psf: PsfCalibration) -> None:
    trend = psf.height_trend
    assert trend is not None
    section = widths_section(psf)
    assert section is not None
    assert "change of the width with the height is not significant" in section.text[0]
    drifting = trend.model_copy(update={"is_drift": True, "p_value": 1e-6})
    section = widths_section(psf.model_copy(update={"height_trend": drifting}))
    assert section is not None
    text = section.text[0]
    assert "the focus drifts" in text
    assert "1e-06" in text


@pytest.mark.slow
def test_how_it_was_measured_is_said(psf: PsfCalibration) -> None:
    other = PsfCalibration(sigma_x_px=0.8, method="paper", region="centre", channel="green")
    text = " ".join(calibration_sections(other, lambda _: np.zeros((2, 2)))[0].text)
    assert "biased by +5 % at 0.5 px" in text
    assert "Only the region centre of the frame was used." in text
    assert "Colour: green." in text
    colours = psf.model_copy(update={"channels": {"red": psf, "green": psf}})
    table = calibration_sections(colours.model_copy(update={"edges": []}), lambda _: np.zeros(1))[
        0
    ].tables[1]
    assert [row[0] for row in table.rows] == ["red", "green"]


def calibrated(
    sigma_x_px: float, captured_utc: str | None, serial: str | None = "A7"
) -> PsfCalibration:
    return PsfCalibration.model_validate(
        {
            "sigma_x_px": sigma_x_px,
            "sigma_x_err_px": 0.002,
            "sigma_y_px": 0.7,
            "sigma_y_err_px": 0.002,
            "camera": {"serial": serial},
            "captured_utc": captured_utc,
        }
    )


HISTORY = (
    ("later.json", calibrated(0.85, "2025-05-02T08:00:00.000000Z")),
    ("other.json", calibrated(0.60, "2025-03-01T08:00:00.000000Z", "B1")),
    ("first.json", calibrated(0.80, "2025-03-04T08:00:00.000000Z")),
    ("photo.json", calibrated(0.80, None, None)),
)


def test_calibrations_stand_by_camera_and_time_each_against_the_first() -> None:
    history = ordered_history(HISTORY)
    assert list(history) == ["A7", "B1", "unknown"]
    first, later = history["A7"]
    assert (first.name, first.verdict) == ("first.json", "")
    assert later.verdict.startswith("the PSF has changed: sigma_x_px by +6.25 %")
    document = history_document(history)
    assert document["cameras"][0]["calibrations"][1]["change"] == later.verdict


def test_a_camera_has_a_table_and_from_two_times_on_a_figure() -> None:
    known, lone, unknown = history_sections(ordered_history(HISTORY))
    assert known.title == "Camera A7"
    # 1.96 times the standard error of 0.002.
    assert known.tables[0].rows[0][:3] == ("first.json", "2025-03-04 08:00:00", "0.8000 ± 0.0039")
    assert len(known.figures) == 1
    assert lone.figures == unknown.figures == ()
    assert unknown.tables[0].rows[0][1] == "unknown"


def test_widths_are_drawn_with_their_intervals() -> None:
    figure = plot_history(ordered_history(HISTORY)["A7"])
    assert figure is not None
    assert len(figure.axes[0].containers) == 2
    assert figure.axes[0].get_ylabel() == "total sigma / px"


def test_what_cannot_be_compared_says_so() -> None:
    bare = PsfCalibration.model_validate({"sigma_x_px": 0.8, "camera": {"serial": "A7"}})
    [_, second] = ordered_history([("a", bare), ("b", bare)])["A7"]
    assert second.verdict.startswith("not comparable: no width in common")


def test_a_width_that_no_calibration_has_is_not_drawn() -> None:
    lone = [
        (name, one.model_copy(update={"sigma_y_px": None, "sigma_y_err_px": None}))
        for name, one in (HISTORY[0], HISTORY[2])
    ]
    figure = plot_history(ordered_history(lone)["A7"])
    assert figure is not None
    [axes] = figure.axes
    assert len(axes.containers) == 1
