"""The first page of a PSF report: the verdict, what was measured with what, and the warnings."""

from collections.abc import Iterable

from analysis.reports.page import (
    ReportFront,
    ReportSection,
    ReportTable,
    encodings_text,
)
from calibration.psf import PsfCalibration
from calibration.sharpness import VERDICT_COLUMNS, SharpnessVerdict, verdict_rows

_UNSTATED = "not stated"
_NAMED_BY_PEOPLE = ("customer", "target")
_NAMED_BY_FILES = ("camera", "lens")
"""What people say comes before what files say."""
_FACTS = (
    ("camera", "camera"),
    ("lens", "lens"),
    ("focal_length_mm", "focal length"),
    ("f_number", "f-number"),
    ("exposure_s", "exposure"),
    ("iso", "ISO"),
)


def calibration_front(psf: PsfCalibration, warnings: Iterable[str]) -> ReportFront:
    """Return the verdict, the facts about the photographs, and the command's warnings."""
    return ReportFront(
        outcome="none" if psf.verdict is None else psf.verdict.outcome,
        verdict=_sentence(psf.verdict),
        facts=tuple(_facts(psf)),
        warnings=tuple(warnings),
    )


def _sentence(verdict: SharpnessVerdict | None) -> str:
    if verdict is None:
        return "The measurement is not compared with limits."
    total = len(verdict.limits)
    counts = {
        name: sum(one.outcome == name for one in verdict.limits)
        for name in ("pass", "fail", "unsure")
    }
    words = {"pass": "passed", "fail": "failed", "unsure": "unsure"}
    said = ", ".join(f"{count} {words[name]}" for name, count in counts.items() if count)
    return f"{total} limit{'s' * (total != 1)} of {verdict.limits_file}: {said}."


def _facts(psf: PsfCalibration) -> Iterable[tuple[str, str]]:
    stated = dict(psf.photograph or {})
    if psf.camera is not None and psf.camera.model and "camera" not in stated:
        names = (psf.camera.vendor, psf.camera.model, psf.camera.serial)
        stated["camera"] = " ".join(name for name in names if name)
    labels = psf.labels or {}
    stated.update({name: text for name, text in labels.items() if name in _NAMED_BY_FILES})
    for name in _NAMED_BY_PEOPLE:
        if name in labels:
            yield name, labels[name]
    taken = psf.captured_utc or stated.get("taken")
    yield "photographed", _UNSTATED if taken is None else _moment(str(taken))
    yield "measured", _UNSTATED if psf.provenance is None else _moment(psf.provenance.created)
    for key, label in _FACTS:
        yield label, _text(key, stated.get(key))
    yield "encoding", encodings_text(psf.provenance) or _UNSTATED
    width, height = psf.picture_width_px, psf.picture_height_px
    yield "picture", _UNSTATED if width is None else f"{width} x {height} px"
    pitch = psf.pixel_pitch_um
    yield (
        "pixel pitch",
        "unknown" if pitch is None else f"{pitch:g} µm ({psf.pixel_pitch_from})",
    )


def _moment(written: str) -> str:
    """A time as people read it: of Exif in the camera's own time, of ours in UTC."""
    day, _, time = written.replace(" ", "T").partition("T")
    zone = " UTC" if time.endswith(("Z", "+00:00")) else ""
    return f"{day} {time[:5]}{zone}" if time else written


def _text(key: str, value: str | float | None) -> str:
    if value is None or value == "":
        return _UNSTATED
    if isinstance(value, str):
        return value
    if key == "exposure_s":
        return f"1/{1 / value:.0f} s" if 0 < value < 0.3 else f"{value:g} s"
    return {"focal_length_mm": f"{value:g} mm", "f_number": f"f/{value:g}"}.get(key, f"{value:g}")


def verdict_section(psf: PsfCalibration) -> ReportSection | None:
    """Tabulate every limit with its figure; None without limits."""
    if psf.verdict is None:
        return None
    return ReportSection(
        title="Limits",
        text=(
            "A limit is passed where the whole interval keeps it, failed where none of it does, "
            "and unsure where the interval straddles it. Over several edges or corners the "
            "intervals are widened so that they hold all together (Bonferroni).",
        ),
        tables=(
            ReportTable(
                columns=VERDICT_COLUMNS,
                rows=verdict_rows(psf.verdict),
                ends_in_words=True,
            ),
        ),
    )
