"""The sections of a comparison: verdict, views with the list of changes, and how it was made."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from math import isfinite
from typing import TypeAlias

from analysis.changes import (
    Change,
    ChangeSummary,
    describe_depth,
    describe_focus,
    describe_least,
    describe_limit,
    describe_moved,
    describe_prediction,
)
from analysis.choices import acceptance
from analysis.detection_limits import DetectionLimit, SpotLimit, size_text
from analysis.pose import PoseSummary
from analysis.reports._bench import versions
from analysis.reports._page import (
    Report,
    ReportFigure,
    ReportFront,
    ReportSection,
    ReportTable,
    Verdict,
    as_sentence,
    encodings_text,
    number_text,
    present,
)
from calibration.estimate import NORMAL_95, signed_with_reach, with_reach

_LISTED = 200
"""Rows of the list in a page; changes.csv has all."""

_KERNELS = {
    "calibrated": "from psf.json and the pose",
    "pair": "fitted to the two photographs",
    "both": "fitted to the two photographs, constrained to psf.json within its errors",
}
_LEAST_Q = 1e-6


def changes_report(
    summary: ChangeSummary,
    views: Sequence[ReportFigure],
    limit_map: ReportFigure | None = None,
    facts: Sequence[tuple[str, str]] = (),
    depth_map: ReportFigure | None = None,
) -> Report:
    """Return the report of a comparison.

    ``limit_map, depth_map``: what `limit_figure` and `depth_figure` drew. ``facts``: names and
    values to add to the front page, such as when the photographs were taken.
    """
    limit = summary.detection_limit
    return Report(
        title="Changes",
        subtitle=f"{summary.followup} against {summary.reference}",
        verdicts=_verdicts(summary),
        sections=present(
            changes_section(summary, views),
            None if limit is None else limit_section(limit, limit_map),
            None if summary.parallax is None else _depth_section(summary, depth_map),
            _comparison_section(summary),
        ),
        provenance=versions(),
        origin=summary.provenance,
        front=ReportFront(
            outcome="unsure" if summary.changes else "none",
            label=count_text(len(summary.changes)),
            verdict=" ".join(
                [
                    f"{_comparison_sentence(summary)}.",
                    *_told(summary, (describe_depth, *_LIMIT_AND_PREDICTION)),
                ]
            ),
            facts=(
                *facts,
                ("encoding", encodings_text(summary.provenance) or "not stated"),
                ("zoom, follow-up over reference", f"{summary.zoom:.3f}"),
                ("clipped", f"{summary.saturated_px} px"),
            ),
            warnings=summary.warnings,
        ),
    )


_Describe: TypeAlias = Callable[[ChangeSummary], str | None]
_LIMIT_AND_PREDICTION: tuple[_Describe, ...] = (describe_limit, describe_prediction)


def _told(summary: ChangeSummary, those: Iterable[_Describe]) -> Iterator[str]:
    """What there is to say of a comparison, in sentences."""
    return (as_sentence(text) for describe in those if (text := describe(summary)) is not None)


def count_text(count: int) -> str:
    """Return how many changes there are, as people say it."""
    return {0: "no change", 1: "1 change"}.get(count, f"{count} changes")


def _comparison_sentence(summary: ChangeSummary) -> str:
    """Say how many pixels differ, and how many or which share chance alone makes."""
    if summary.false_discovery_rate is not None:
        return (
            f"about {100 * summary.false_discovery_rate:g} % of the listed changes are expected to "
            "be false"
        )
    return (
        f"{summary.changed_px} of {summary.compared_px} pixels differ by more than "
        f"{summary.threshold_sd:.2f} standard deviations; by chance alone, expect "
        f"{summary.false_alarms_px:g} per frame"
    )


def _verdicts(summary: ChangeSummary) -> tuple[Verdict, ...]:
    strongest = max(summary.changes, key=lambda one: one.significance, default=None)
    told = ""
    if strongest is not None:
        deviations = f"{strongest.significance:.1f} standard deviations"
        told = f"the strongest {amplitude_text(strongest)} DN, {deviations}"
    compared = f"of {summary.compared_px} that were compared"
    blur, err = f"{summary.extra_blur_px2:z.2f}", summary.extra_blur_err_px2
    if isfinite(err):
        blur = signed_with_reach(summary.extra_blur_px2, NORMAL_95 * err)
    return (
        Verdict("changes", str(len(summary.changes)), told),
        Verdict("changed pixels", str(summary.changed_px), compared),
        Verdict("blur", f"{blur} px²", _KERNELS.get(summary.kernel or "", "")),
        Verdict("light", f"x {summary.gain:.3f}", "follow-up over reference"),
    )


def changes_section(summary: ChangeSummary, views: Sequence[ReportFigure]) -> ReportSection:
    """Show the views, and under them the list of changes that they number."""
    small, count = describe_least(summary), len(summary.changes)
    cut = f"The first {_LISTED} of {count} changes are listed; changes.csv has all."
    moved = tuple(_told(summary, (describe_moved,)))
    return ReportSection.of(
        "Before and after",
        "Grey hatching: not compared, since one of the photographs does not show it. Orange: "
        "clipped. Violet: left out by the mask. Click a row of the list to see its change.",
        cut if count > _LISTED else None,
        None if small is None else f"{small}.",
        *moved,
        _list_table(summary.changes) if summary.changes else None,
        _moved_table(summary.moved) if moved else None,
        *views,
        has_views=True,
    )


def limit_section(limit: DetectionLimit, limit_map: ReportFigure | None) -> ReportSection:
    """Show what would have been found: the map, and the limits for several widths."""
    columns: dict[str, Callable[[SpotLimit], str]] = {
        "spot, sigma": lambda spot: size_text(spot, limit),
        "half the area / DN": lambda spot: f"{spot.median_dn:.3g}",
        "95 % of it / DN": lambda spot: f"{spot.p95_dn:.3g}",
        "worst place / DN": lambda spot: f"{spot.worst_dn:.3g}",
    }
    if limit.contrast_dn is not None:
        columns[f"found at {limit.contrast_dn:g} DN"] = lambda spot: (
            ""
            if spot.reached_fraction is None
            else f"{100 * spot.reached_fraction:.1f} % of the area"
        )
    return ReportSection.of(
        "What would have been found",
        f"The amplitude that a Gaussian spot needs to be found {100 * limit.power:.0f} times out "
        "of 100, at the stated false alarms. The width is that of the spot in the follow-up; it is "
        "listed if it stands out at any of the filters. Other shapes, such as a line, are found at "
        "a lower amplitude if they are longer, and at a higher one if they are narrower.",
        limit_map,
        ReportTable.of(
            limit.spots,
            columns,
            "Amplitudes in the follow-up's levels, over the compared pixels.",
        ),
    )


def _depth_section(summary: ChangeSummary, depth_map: ReportFigure | None) -> ReportSection:
    """Show how far from a plane the scene is."""
    found = summary.parallax
    assert found is not None, "a scene with depth"
    heights = found.heights
    rows = present(
        ("parallax, 1 to 99 % of the pixels", f"{found.low_px:+.2f} to {found.high_px:+.2f} px"),
        ("its standard error, median", f"{found.err_px:.3f} px"),
        None if found.larger_is is None else ("what has the larger parallax", found.larger_is),
        *(
            ()
            if heights is None
            else (
                (
                    "height above the plane, 1 to 99 % of the pixels",
                    f"{heights.low_mm:+.3g} to {heights.high_mm:+.3g} mm",
                ),
                ("its standard error, median", f"{heights.err_mm:.2g} mm"),
                ("distance of the follow-up's camera", f"{heights.distance_mm:.4g} mm"),
                ("distance between the two cameras", f"{heights.baseline_mm:.3g} mm"),
            )
        ),
        (
            "of what a plane leaves in held-out blocks, explained",
            f"{100 * found.held_out_gain:.0f} %",
        ),
        ("features within a pixel of their lines", f"{found.agreeing} of {found.features}"),
        ("hidden, at a step or unknown", f"{found.hidden_px} px"),
    )
    return ReportSection.of(
        "Depth of the scene",
        "Every pixel was compared at its own depth: nearer and farther parts are displaced beside "
        "the plane along the lines through the epipole, where the other camera stood. What one of "
        "the two hides is not compared.",
        depth_map,
        ReportTable(columns=("", "value"), rows=rows, caption="Pixels are the follow-up's."),
    )


def _list_table(changes: Sequence[Change]) -> ReportTable:
    """Tabulate changes, numbered from 1."""
    table = ReportTable.of(
        enumerate(changes[:_LISTED], 1),
        {
            "change": lambda one: str(one[0]),
            "what": lambda one: _what(one[1]),
            "x / px": lambda one: f"{one[1].x_px:.1f}",
            "y / px": lambda one: f"{one[1].y_px:.1f}",
            "reference x / px": lambda one: f"{one[1].reference_x_px:.1f}",
            "reference y / px": lambda one: f"{one[1].reference_y_px:.1f}",
            "area / px": lambda one: f"{one[1].area_px:.0f}",
            "sigma / px": lambda one: number_text(one[1].spot_sigma_px, ".1f"),
            "amplitude / DN": lambda one: amplitude_text(one[1]),
            "significance": lambda one: f"{one[1].significance:.1f}",
            "q value": lambda one: q_text(one[1].q_value),
        },
        "Changes, first what catches the eye first; amplitudes are after minus before in "
        "the follow-up's levels.",
    )
    return replace(table, is_of_changes=True)


def _what(change: Change) -> str:
    parts = f" ({len(change.parts)} parts)" if change.parts else ""
    return f"{change.what or ''}{parts}"


def _moved_table(moved: Sequence[Change]) -> ReportTable:
    """Tabulate movements, in their order."""
    return ReportTable.of(
        moved[:_LISTED],
        {
            "x / px": lambda change: f"{change.x_px:.1f}",
            "y / px": lambda change: f"{change.y_px:.1f}",
            "moved right / px": lambda change: _displacement(change, 0),
            "moved down / px": lambda change: _displacement(change, 1),
            "area / px": lambda change: f"{change.area_px:.0f}",
            "significance": lambda change: f"{change.significance:.1f}",
        },
        "Movements: what a shift of what was there explains, with its 95 % interval.",
    )


def _displacement(change: Change, axis: int) -> str:
    if change.displacement_px is None or change.displacement_err_px is None:
        return ""
    reach_px = NORMAL_95 * change.displacement_err_px[axis]
    return f"{change.displacement_px[axis]:+.1f} ± {reach_px:.1f}"


def q_text(q_value: float) -> str:
    """Return a q value as people read it: far below one false change in a million says enough."""
    return f"{q_value:.2g}" if q_value >= _LEAST_Q else f"< {_LEAST_Q:g}"


def amplitude_text(change: Change) -> str:
    """Return a change's amplitude in DN with half its 95 % interval."""
    return signed_with_reach(change.amplitude_dn, NORMAL_95 * change.amplitude_err_dn)


def _comparison_section(summary: ChangeSummary) -> ReportSection:
    k1_err = summary.distortion_k1_err
    k1_reach = None if k1_err is None else NORMAL_95 * k1_err
    noise = f"{summary.noise_factor:.3g} DN², fitted"
    if summary.is_noise_known:
        noise = f"{summary.noise_factor:.2f} of noise.json's"
    rows = (
        ("distortion of the lens, k1", with_reach(summary.distortion_k1, k1_reach, 5)),
        ("noise variance", noise),
        ("registration along the gradient", f"{summary.registration_err_px:.3f} px"),
        ("error of the blur", f"{summary.width_err_px2:.3f} px²"),
        *(
            (f"homography, row {number}", "  ".join(f"{value:.8g}" for value in row))
            for number, row in enumerate(summary.homography, 1)
        ),
    )
    return ReportSection.of(
        "How the photographs were compared",
        *_told(summary, (describe_focus,)),
        None
        if summary.kernel is None
        else f"The blur between the photographs was {_KERNELS[summary.kernel]}.",
        ReportTable(
            columns=("", "value"),
            rows=rows,
            caption="The homography takes follow-up pixels (x, y, 1) to reference pixels.",
        ),
    )


_STORED_LISTED = 20
_FIGURE_WIDTH_IN = 7.0


def stored_changes_section(
    name: str, summary: ChangeSummary, figure_png: bytes | None
) -> ReportSection:
    """Show a stored changes.json, and its figure if it is there."""
    caption = "The follow-up with its changes outlined, both differences, and the significance."
    cut = f"The first {_STORED_LISTED} changes are listed."
    return ReportSection.of(
        f"Changes: {name}",
        f"{summary.followup} against {summary.reference}: {count_text(len(summary.changes))}. "
        f"{_comparison_sentence(summary)}.",
        *_told(summary, (describe_depth, *_LIMIT_AND_PREDICTION, describe_focus)),
        *(f"Warning: {warning}." for warning in summary.warnings),
        cut if len(summary.changes) > _STORED_LISTED else None,
        _list_table(summary.changes[:_STORED_LISTED]) if summary.changes else None,
        None if figure_png is None else ReportFigure.of_png(figure_png, caption, _FIGURE_WIDTH_IN),
    )


def stored_pose_section(name: str, verdict: PoseSummary) -> ReportSection:
    """Show a stored pose.json; ``name`` is that of its file or folder."""
    chance = verdict.verdict is not None and verdict.probability is not None
    rows = present(
        ("verdict", verdict.verdict or "") if chance else None,
        (
            "probability that d' reaches the threshold",
            f"{100 * (verdict.probability or 0.0):.1f} %",
        )
        if chance
        else None,
        ("d' by the criterion", f"{verdict.dprime_decisive:.2f}"),
        ("threshold", f"{verdict.min_dprime:g}"),
        ("local zoom", f"{verdict.zoom_min:.3f} to {verdict.zoom_max:.3f}"),
        ("anisotropy, up to", f"{verdict.anisotropy_max:.3f}"),
        ("overlap", f"{100 * verdict.overlap:.0f} % of the follow-up"),
        None
        if verdict.parallax is None
        else ("parallax of 95 % of the pixels", f"{verdict.parallax.range_px:.1f} px"),
        *(
            (f"share of {one.source} in the uncertainty", f"{100 * one.share:.0f} %")
            for one in (verdict.budget if chance else ())
        ),
    )
    return ReportSection.of(
        f"Pose: {name}",
        f"The pose is {acceptance(verdict.is_accepted)} by criterion "
        f"{verdict.criterion}. d' is an upper bound: registration, light, gloss, parallax and "
        "defocus only lower it.",
        None if verdict.parallax is None else as_sentence(verdict.parallax.sentence),
        *(f"Warning: {warning}." for warning in verdict.warnings),
        ReportTable(columns=("", "value"), rows=rows),
    )
