"""The sections of a comparison: verdict, views with the list of changes, and how it was made."""

from base64 import b64encode
from collections.abc import Sequence
from math import isfinite

from markupsafe import Markup

from analysis.changes import (
    Change,
    ChangeSummary,
    describe_focus,
    describe_least,
    describe_limit,
    describe_moved,
    describe_prediction,
)
from analysis.choices import acceptance
from analysis.detection_limits import DetectionLimit, size_text
from analysis.pose import PoseSummary
from analysis.reports.bench import versions
from analysis.reports.page import (
    Report,
    ReportFigure,
    ReportFront,
    ReportSection,
    ReportTable,
    Verdict,
    encodings_text,
    render_report,
)
from calibration.estimate import NORMAL_95

_LISTED = 200
"""Rows of the list in a page; changes.csv has all."""

_KERNELS = {
    "calibrated": "from psf.json and the pose",
    "pair": "fitted to the two photographs",
    "both": "fitted to the two photographs, held to psf.json as far as that is sure",
}
_LEAST_Q = 1e-6


def render_changes_report(
    summary: ChangeSummary,
    views: Sequence[ReportFigure],
    limit_map: ReportFigure | None = None,
    facts: Sequence[tuple[str, str]] = (),
) -> str:
    """Return the report of a comparison as one HTML document.

    ``facts``: names and values to add to the front page, such as when the photographs were taken.
    """
    return render_report(
        Report(
            title="Changes",
            subtitle=f"{summary.followup} against {summary.reference}",
            verdicts=_verdicts(summary),
            sections=(
                changes_section(summary, views),
                *(
                    (limit_section(summary.detection_limit, limit_map),)
                    if summary.detection_limit is not None
                    else ()
                ),
                _comparison_section(summary),
            ),
            provenance=versions(),
            origin=summary.provenance,
            front=_front(summary, facts),
        )
    )


def count_text(count: int) -> str:
    """Return how many changes there are, as people say it."""
    return {0: "no change", 1: "1 change"}.get(count, f"{count} changes")


def _front(summary: ChangeSummary, facts: Sequence[tuple[str, str]]) -> ReportFront:
    return ReportFront(
        outcome="unsure" if summary.changes else "none",
        label=count_text(len(summary.changes)),
        verdict=_front_sentence(summary),
        facts=(
            *facts,
            ("encoding", encodings_text(summary.provenance) or "not stated"),
            ("zoom, follow-up over reference", f"{summary.zoom:.3f}"),
            ("clipped", f"{summary.saturated_px} px"),
        ),
        warnings=summary.warnings,
    )


def _front_sentence(summary: ChangeSummary) -> str:
    said = f"{_comparison_sentence(summary)}."
    for sentence in (describe_limit(summary), describe_prediction(summary)):
        if sentence is not None:
            said += f" {sentence[0].upper()}{sentence[1:]}."
    return said


def _comparison_sentence(summary: ChangeSummary) -> str:
    """Say how many pixels differ, and how many or which share chance alone makes."""
    if summary.false_discovery_rate is not None:
        return (
            f"about {100 * summary.false_discovery_rate:g} % of the listed changes are expected to "
            "be false"
        )
    return (
        f"{summary.changed_px} of {summary.compared_px} pixels differ by more than "
        f"{summary.threshold_sd:.2f} standard deviations; chance alone makes "
        f"{summary.false_alarms_px:g} a frame"
    )


def _verdicts(summary: ChangeSummary) -> tuple[Verdict, ...]:
    strongest = max(summary.changes, key=lambda one: one.significance, default=None)
    return (
        Verdict(name="changes", value=str(len(summary.changes)), remark=_strongest(strongest)),
        Verdict(
            name="changed pixels",
            value=str(summary.changed_px),
            remark=f"of {summary.compared_px} that were compared",
        ),
        Verdict(
            name="blur", value=_blur_value(summary), remark=_KERNELS.get(summary.kernel or "", "")
        ),
        Verdict(name="light", value=f"x {summary.gain:.3f}", remark="follow-up over reference"),
    )


def _strongest(change: Change | None) -> str:
    if change is None:
        return ""
    return f"the strongest {_amplitude(change)} DN, {change.significance:.1f} standard deviations"


def _blur_value(summary: ChangeSummary) -> str:
    err = summary.extra_blur_err_px2
    reach = f" ± {NORMAL_95 * err:.2f}" if isfinite(err) else ""
    return f"{summary.extra_blur_px2:z.2f}{reach} px²"


def changes_section(summary: ChangeSummary, views: Sequence[ReportFigure]) -> ReportSection:
    """Show the views, and under them the list of changes that they number."""
    text = [
        "Grey hatching: not compared, since one of the photographs does not show it. Orange: "
        "clipped. Violet: left out by the mask. Click a row of the list to see its change."
    ]
    if len(summary.changes) > _LISTED:
        text.append(
            f"The first {_LISTED} of {len(summary.changes)} changes are listed; changes.csv has "
            "all."
        )
    tables = (_list_table(summary.changes),) if summary.changes else ()
    small = describe_least(summary)
    if small is not None:
        text.append(f"{small}.")
    moved = describe_moved(summary)
    if moved is not None:
        text.append(f"{moved[0].upper()}{moved[1:]}.")
        tables = (*tables, _moved_table(summary.moved))
    return ReportSection(
        title="Before and after", text=tuple(text), figures=tuple(views), tables=tables,
        has_views=True,
    )  # fmt: skip


def limit_section(limit: DetectionLimit, limit_map: ReportFigure | None) -> ReportSection:
    """Show what would have been found: the map, and the limits for several widths."""
    text = (
        f"The amplitude that a Gaussian spot needs to be found {100 * limit.power:.0f} times of "
        "100, at the stated false alarms. The width is the spot's as the follow-up shows it; it "
        "is listed if it stands out at any of the filters. What is no spot, such as a line, is "
        "found at a lower amplitude if it is longer, and at a higher one if it is narrower.",
    )
    asked = () if limit.contrast_dn is None else (f"found at {limit.contrast_dn:g} DN",)
    rows = []
    for spot in limit.spots:
        row = [size_text(spot, limit)]
        row += [f"{value:.3g}" for value in (spot.median_dn, spot.p95_dn, spot.worst_dn)]
        if asked and spot.reached_fraction is not None:
            row.append(f"{100 * spot.reached_fraction:.1f} % of the area")
        rows.append(tuple(row))
    return ReportSection(
        title="What would have been found",
        text=text,
        figures=() if limit_map is None else (limit_map,),
        tables=(
            ReportTable(
                columns=(
                    "spot, sigma",
                    "half the area / DN",
                    "95 % of it / DN",
                    "worst place / DN",
                    *asked,
                ),
                rows=tuple(rows),
                caption="Amplitudes in the follow-up's levels, over the compared pixels.",
            ),
        ),
    )


def _list_table(changes: Sequence[Change]) -> ReportTable:
    """Tabulate changes, numbered from 1."""
    return ReportTable(
        columns=(
            "change",
            "what",
            "x / px",
            "y / px",
            "reference x / px",
            "reference y / px",
            "area / px",
            "sigma / px",
            "amplitude / DN",
            "significance",
            "q value",
        ),
        rows=tuple(
            (
                str(number),
                _what(change),
                f"{change.x_px:.1f}",
                f"{change.y_px:.1f}",
                f"{change.reference_x_px:.1f}",
                f"{change.reference_y_px:.1f}",
                f"{change.area_px:.0f}",
                "" if change.spot_sigma_px is None else f"{change.spot_sigma_px:.1f}",
                _amplitude(change),
                f"{change.significance:.1f}",
                q_text(change.q_value),
            )
            for number, change in enumerate(changes[:_LISTED], 1)
        ),
        caption="Changes, first what catches the eye first; amplitudes are after minus before in "
        "the follow-up's levels.",
        is_of_changes=True,
    )


def _what(change: Change) -> str:
    parts = f" ({len(change.parts)} parts)" if change.parts else ""
    return f"{change.what or ''}{parts}"


def _moved_table(moved: Sequence[Change]) -> ReportTable:
    """Tabulate movements, in their order."""
    return ReportTable(
        columns=("x / px", "y / px", "moved right / px", "moved down / px", "area / px",
                 "significance"),
        rows=tuple(
            (
                f"{change.x_px:.1f}",
                f"{change.y_px:.1f}",
                *_displacement(change),
                f"{change.area_px:.0f}",
                f"{change.significance:.1f}",
            )
            for change in moved[:_LISTED]
        ),
        caption="Movements: what a shift of what was there explains, with its 95 % interval.",
    )  # fmt: skip


def _displacement(change: Change) -> tuple[str, str]:
    if change.displacement_px is None or change.displacement_err_px is None:
        return "", ""
    (x, y), (x_err, y_err) = change.displacement_px, change.displacement_err_px
    return (f"{x:+.1f} ± {NORMAL_95 * x_err:.1f}", f"{y:+.1f} ± {NORMAL_95 * y_err:.1f}")


def q_text(q_value: float) -> str:
    """Return a q value as people read it: far below one false change in a million says enough."""
    return f"{q_value:.2g}" if q_value >= _LEAST_Q else f"< {_LEAST_Q:g}"


def _amplitude(change: Change) -> str:
    return f"{change.amplitude_dn:+.3g} ± {NORMAL_95 * change.amplitude_err_dn:.2g}"


def _comparison_section(summary: ChangeSummary) -> ReportSection:
    focus = describe_focus(summary)
    text = [f"{focus[0].upper()}{focus[1:]}."] if focus else []
    if summary.kernel is not None:
        text.append(f"The blur between the photographs was {_KERNELS[summary.kernel]}.")
    rows = [
        ("distortion of the lens, k1", _with_err(summary.distortion_k1, summary.distortion_k1_err)),
        ("noise variance", _noise_text(summary)),
        ("registration along the gradient", f"{summary.registration_err_px:.3f} px"),
        ("error of the blur", f"{summary.width_err_px2:.3f} px²"),
    ]
    matrix = tuple(
        (f"homography, row {number}", "  ".join(f"{value:.8g}" for value in row))
        for number, row in enumerate(summary.homography, 1)
    )
    return ReportSection(
        title="How the photographs were compared",
        text=tuple(text),
        tables=(
            ReportTable(
                columns=("", "value"),
                rows=(*rows, *matrix),
                caption="The homography takes follow-up pixels (x, y, 1) to reference pixels.",
            ),
        ),
    )


def _with_err(value: float, err: float | None) -> str:
    return f"{value:.5f}" if err is None else f"{value:.5f} ± {NORMAL_95 * err:.2g}"


def _noise_text(summary: ChangeSummary) -> str:
    if summary.is_noise_known:
        return f"{summary.noise_factor:.2f} of noise.json's"
    return f"{summary.noise_factor:.3g} DN², fitted"


_STORED_LISTED = 20
_FIGURE_WIDTH_IN = 7.0


def stored_changes_section(
    name: str, summary: ChangeSummary, figure_png: bytes | None
) -> ReportSection:
    """Show a stored changes.json, and its figure if it is there."""
    text = [
        f"{summary.followup} against {summary.reference}: {count_text(len(summary.changes))}. "
        f"{_comparison_sentence(summary)}."
    ]
    said = (describe_limit(summary), describe_prediction(summary), describe_focus(summary))
    text += [f"{sentence[0].upper()}{sentence[1:]}." for sentence in said if sentence is not None]
    text += [f"Warning: {warning}." for warning in summary.warnings]
    if len(summary.changes) > _STORED_LISTED:
        text.append(f"The first {_STORED_LISTED} changes are listed.")
    figures: tuple[ReportFigure, ...] = ()
    if figure_png is not None:
        encoded = b64encode(figure_png).decode("ascii")
        image = Markup(f'<img alt="" src="data:image/png;base64,{encoded}">')  # noqa: S704 - base64
        caption = "The follow-up with its changes outlined, both differences, and the significance."
        figures = (ReportFigure(markup=image, caption=caption, width_in=_FIGURE_WIDTH_IN),)
    return ReportSection(
        title=f"Changes: {name}",
        text=tuple(text),
        tables=(_list_table(summary.changes[:_STORED_LISTED]),) if summary.changes else (),
        figures=figures,
    )


def stored_pose_section(name: str, verdict: PoseSummary) -> ReportSection:
    """Show a stored pose.json; ``name`` is that of its file or folder."""
    rows: tuple[tuple[str, str], ...] = (
        ("d' by the criterion", f"{verdict.dprime_decisive:.2f}"),
        ("threshold", f"{verdict.min_dprime:g}"),
        ("local zoom", f"{verdict.zoom_min:.3f} to {verdict.zoom_max:.3f}"),
        ("anisotropy, up to", f"{verdict.anisotropy_max:.3f}"),
        ("overlap", f"{100 * verdict.overlap:.0f} % of the follow-up"),
    )
    if verdict.verdict is not None and verdict.probability is not None:
        rows = (
            ("verdict", verdict.verdict),
            ("probability that d' reaches the threshold", f"{100 * verdict.probability:.1f} %"),
            *rows,
            *(
                (f"share of {one.source} in the uncertainty", f"{100 * one.share:.0f} %")
                for one in verdict.budget
            ),
        )
    text = [
        f"The pose is {acceptance(verdict.is_accepted)} by criterion "
        f"{verdict.criterion}. d' is an upper bound: registration, light, gloss, parallax and "
        "defocus only lower it."
    ]
    text += [f"Warning: {warning}." for warning in verdict.warnings]
    return ReportSection(
        title=f"Pose: {name}",
        text=tuple(text),
        tables=(ReportTable(columns=("", "value"), rows=rows),),
    )
