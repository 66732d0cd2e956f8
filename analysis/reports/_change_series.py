"""The page on several follow-ups: each with its result, and each change over all of them."""

from collections.abc import Sequence
from dataclasses import replace
from urllib.parse import quote

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from acquisition.photographs import on_screen, white_level_dn
from analysis.change_series import (
    ChangesSeries,
    ChangeTimeLine,
    ChangeTrack,
    ComparedFollowup,
    TimeLineFollowup,
)
from analysis.reports._bench import versions
from analysis.reports._page import (
    Report,
    ReportFigure,
    ReportFront,
    ReportSection,
    ReportTable,
    Verdict,
    encodings_text,
    in_report_style,
    moment_text,
    new_plot,
    number_text,
    present,
)
from calibration.estimate import NORMAL_95, signed_with_reach
from simulation.arrays import AnyArray
from simulation.palette import BLUE, INK, PALETTE, VERMILION

_LISTED = 300
"""Follow-ups in the table of a page; changes.csv has all."""

_TRACKS_LISTED, _TRACKS_DRAWN, _TRACKS_ON_MAP = 100, 8, 40
_DRAWN_PX = 1500  # longest side of a reference in colour
_LEVEL_LETTERS = 6  # of names that fit side by side
_COLOURS = (*PALETTE, "#7A5C00", "#000000")
_SEEN, _NOT_SEEN, _NOT_COMPARED = VERMILION, "#DDE3E9", "#FFFFFF"


def series_report(
    series: ChangesSeries,
    followups: Sequence[ComparedFollowup],
    time_line: ChangeTimeLine | None,
    reference_dn: AnyArray | None,
) -> Report:
    """Return the report of several follow-ups.

    ``time_line``: of the changes; None for pairs, or for very many follow-ups. ``reference_dn``:
    the reference, for a map of the tracks: shape ``(rows, cols)``, or ``(rows, cols, 3)`` in
    colour, linear in light.
    """
    tracks = None
    if time_line is not None:
        lasting = sum(track.seen > 1 for track in time_line.tracks)
        told = f"{lasting} seen in several follow-ups"
        tracks = Verdict("tracks", str(len(time_line.tracks)), told)
    return Report(
        title="Changes over several photographs",
        subtitle=series.reference,
        verdicts=present(
            Verdict("compared", str(series.compared), "follow-ups"),
            Verdict("changed", str(series.changed), "with at least one changed pixel"),
            Verdict("refused", str(series.refused), "could not be read or aligned"),
            tracks,
        ),
        sections=present(
            None if time_line is None else _time_line_section(time_line, reference_dn),
            _followups_section(followups, series.compared + series.refused),
        ),
        provenance=versions(),
        origin=series.provenance,
        front=ReportFront(
            outcome="unsure" if series.changed else "none",
            label=f"{series.changed} of {series.compared} changed",
            verdict="Each follow-up was compared with its reference by itself.",
            facts=(("encoding", encodings_text(series.provenance) or "not stated"),),
            warnings=(
                *(f"no partner: {name}" for name in series.unpaired),
                *(f"not compared: {one.refused}" for one in followups if one.refused),
            ),
        ),
    )


def _followups_section(followups: Sequence[ComparedFollowup], count: int) -> ReportSection:
    shown = followups[:_LISTED]
    table = ReportTable.of(
        shown,
        {
            "follow-up": lambda one: one.folder or one.followup,
            "taken": lambda one: moment_text(one.taken) if one.taken else "",
            "changes": lambda one: "" if one.zoom is None else str(one.changes),
            "changed px": lambda one: "" if one.zoom is None else str(one.changed_px),
            "zoom": lambda one: number_text(one.zoom, ".3f"),
            "remarks": lambda one: (one.refused if one.zoom is None else one.warnings) or "",
        },
        ends_in_words=True,
    )
    return ReportSection.of(
        "Follow-ups",
        "Click a follow-up for its own page.",
        f"{len(shown)} of {count} are listed; changes.csv has all." if len(shown) < count else None,
        replace(table, links=tuple(_address(one.folder) for one in shown)),
    )


def _address(folder: str | None) -> str:
    return "" if folder is None else f"{quote(folder)}/report.html"


def _time_line_section(line: ChangeTimeLine, reference_dn: AnyArray | None) -> ReportSection:
    if not line.tracks:
        return ReportSection.of("Time line", "No follow-up has a change.")
    order = "the time that their files state" if line.order == "time" else "their names"
    return ReportSection.of(
        "Time line",
        f"Follow-ups are in the order of {order}. A track is a change at the same place of the "
        "reference and of the same sign; where it is not in the list of a follow-up, the amplitude "
        "that is excluded at 95 % is shown instead.",
        _tracks_table(line),
        None
        if reference_dn is None
        else ReportFigure.of(
            plot_track_map(line, reference_dn), "The tracks in the reference.", form="png"
        ),
        ReportFigure.of(
            _plot_time_line(line),
            f"Amplitude of {_tracks_drawn(len(line.tracks))}, with 95 % bars; triangles are limits "
            "where a track is not seen.",
        ),
        ReportFigure.of(
            _plot_sightings(line),
            "Where each track was seen (orange), not seen (grey) or not compared (white).",
        ),
    )


def _tracks_drawn(count: int) -> str:
    if count == 1:
        return "the track"
    return f"the {min(count, _TRACKS_DRAWN)} tracks seen most often"


def _tracks_table(line: ChangeTimeLine) -> ReportTable:
    names = [_short(one) for one in line.followups]
    return ReportTable.of(
        enumerate(line.tracks[:_TRACKS_LISTED], 1),
        {
            "track": lambda one: str(one[0]),
            "reference x / px": lambda one: f"{one[1].reference_x_px:.1f}",
            "reference y / px": lambda one: f"{one[1].reference_y_px:.1f}",
            "seen": lambda one: f"{one[1].seen} of {len(one[1].points)}",
            "first": lambda one: names[one[1].first_seen],
            "last": lambda one: names[one[1].last_seen],
            "strongest / DN": lambda one: _strongest_text(one[1]),
        },
        "Tracks, the longest seen first; series.json has all of them with every follow-up.",
    )


def _strongest(track: ChangeTrack) -> tuple[float, float]:
    """Amplitude and its error of the strongest sighting."""
    seen = [
        (point.amplitude_dn, point.amplitude_err_dn)
        for point in track.points
        if point.sighting == "seen"
        and point.amplitude_dn is not None
        and point.amplitude_err_dn is not None
    ]
    return max(seen, key=lambda one: abs(one[0]))


def _strongest_text(track: ChangeTrack) -> str:
    amplitude_dn, err_dn = _strongest(track)
    return signed_with_reach(amplitude_dn, NORMAL_95 * err_dn)


def _short(one: TimeLineFollowup) -> str:
    return one.folder if len(one.folder) <= 24 else f"{one.folder[:22]}…"


@in_report_style
def _plot_time_line(line: ChangeTimeLine) -> Figure:
    """Draw the amplitudes of the first tracks over the follow-ups."""
    figure, axes = new_plot(7.2, 4.0)
    drawn = line.tracks[:_TRACKS_DRAWN]
    for number, (track, colour) in enumerate(zip(drawn, _COLOURS, strict=False), 1):
        # Side by side, where bars would hide each other.
        beside = 0.5 * ((number - 0.5) / len(drawn) - 0.5)
        _draw_track(axes, track, beside, colour, str(number))
    axes.axhline(0, color=INK, linewidth=0.6)
    axes.set(ylabel="amplitude / DN")
    _name_followups(axes, line)
    figure.legend(loc="outside upper center", ncols=min(len(drawn), 8), title="track")
    return figure


def _draw_track(axes: Axes, track: ChangeTrack, beside: float, colour: str, label: str) -> None:
    seen = [
        (number + beside, point.amplitude_dn, NORMAL_95 * (point.amplitude_err_dn or 0.0))
        for number, point in enumerate(track.points)
        if point.sighting == "seen"
    ]
    x, y, reach = np.array(seen, dtype=np.float64).T
    axes.errorbar(
        x, y, yerr=reach, fmt="o-", color=colour, markersize=4, linewidth=0.8, label=label
    )
    sign = np.sign(y[0])
    limits = [
        (number + beside, sign * point.upper_limit_dn)
        for number, point in enumerate(track.points)
        if point.upper_limit_dn is not None
    ]
    if limits:
        at, limit = np.array(limits).T
        marker = "v" if sign > 0 else "^"
        axes.plot(at, limit, marker, color=colour, markersize=4, fillstyle="none")


@in_report_style
def _plot_sightings(line: ChangeTimeLine) -> Figure:
    """Draw a row for each track and a column for each follow-up."""
    drawn = line.tracks[:_TRACKS_ON_MAP]
    codes = {"seen": 0, "not seen": 1, "not compared": 2}
    cells = np.array([[codes[point.sighting] for point in track.points] for track in drawn])
    colours = np.array(
        [[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in (_SEEN, _NOT_SEEN, _NOT_COMPARED)]
    )
    figure, axes = new_plot(7.2, 2.1 + 0.16 * len(drawn))
    axes.imshow(colours[cells], aspect="auto", interpolation="nearest")
    step = max(1, len(drawn) // 20)
    axes.set_yticks(
        np.arange(0, len(drawn), step), [str(k + 1) for k in range(0, len(drawn), step)]
    )
    axes.set(ylabel="track")
    axes.grid(visible=False)
    _name_followups(axes, line)
    return figure


@in_report_style
def plot_track_map(line: ChangeTimeLine, reference_dn: AnyArray) -> Figure:
    """Draw the tracks on the reference, which may be in colour."""
    rows, cols = reference_dn.shape[:2]
    figure, axes = new_plot(5.6, min(5.6 * rows / cols, 6.5))
    if reference_dn.ndim == 3:
        step = -(-max(rows, cols) // _DRAWN_PX)
        drawn, extent = reference_dn[::step, ::step], (-0.5, cols - 0.5, rows - 0.5, -0.5)
        axes.imshow(on_screen(drawn, white_level_dn(drawn)), extent=extent)
    else:
        levels = np.asarray(reference_dn, dtype=np.float64)
        low, high = np.percentile(levels, (0.5, 99.5))
        axes.imshow(levels, cmap="gray", vmin=low, vmax=max(high, low + 1e-9))
    for number, track in enumerate(line.tracks[:_TRACKS_ON_MAP], 1):
        colour = VERMILION if _strongest(track)[0] > 0 else BLUE
        x, y = track.reference_x_px, track.reference_y_px
        halo = [withStroke(linewidth=3, foreground="white")]
        axes.plot(
            x,
            y,
            "o",
            color=colour,
            markersize=9,
            fillstyle="none",
            markeredgewidth=1.6,
            path_effects=halo,
        )
        axes.annotate(
            str(number),
            (x, y),
            (7, 4),
            textcoords="offset points",
            color=colour,
            weight="bold",
            fontsize=11,
            path_effects=halo,
        )
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    return figure


def _name_followups(axes: Axes, line: ChangeTimeLine) -> None:
    count = len(line.followups)
    step = -(-count // 16)
    shown = range(0, count, step)
    names = [_short(line.followups[k]) for k in shown]
    is_long = max(map(len, names)) > _LEVEL_LETTERS
    axes.set_xticks(
        list(shown), names, rotation=30 if is_long else 0, ha="right" if is_long else "center"
    )
    axes.set_xlim(-0.6, count - 0.4)
