import pytest

from analysis.reports.psf.front_page import calibration_front, verdict_section
from calibration.provenance import Provenance
from calibration.psf import CameraIdentity, PsfCalibration
from calibration.sharpness import SharpnessLimits
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
