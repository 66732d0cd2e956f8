"""The calibrations of a camera over time: a table and a figure."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.reports._page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    in_report_style,
    new_figure,
    new_plot,
)
from calibration.errors import CalibrationError
from calibration.estimate import NORMAL_95, with_reach
from calibration.psf import (
    FALSE_ALARMS,
    ControlChart,
    PsfCalibration,
    control_charts,
    focus_repeatability,
    psf_change,
)
from simulation.figures import figure_of
from simulation.palette import BLUE, GREEN, INK, VERMILION

_UNKNOWN = "unknown"
_COLOURS = {"sigma_x_px": BLUE, "sigma_y_px": VERMILION}


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryEntry:
    """One psf.json, with the name of its file.

    ``verdict`` describes the change since the first calibration of its camera; empty for that
    one itself.
    """

    name: str
    psf: PsfCalibration
    verdict: str = ""

    @property
    def serial(self) -> str:
        """Serial number of the camera, or ``unknown``."""
        return (self.psf.camera.serial if self.psf.camera else None) or _UNKNOWN

    @property
    def camera(self) -> str:
        """The serial number, with the lens where that is stated: two lenses have two histories."""
        lens = (self.psf.labels or {}).get("lens")
        return self.serial if lens is None else f"{self.serial}, {lens}"

    @property
    def captured_utc(self) -> str:
        """When its first capture was taken, or ``unknown``."""
        return self.psf.captured_utc or _UNKNOWN


def ordered_history(psfs: Sequence[tuple[str, PsfCalibration]]) -> dict[str, list[HistoryEntry]]:
    """Sort calibrations by camera, lens and time, each compared with the first of its camera.

    Those whose time is not known come first, in the order given.
    """
    by_camera: dict[str, list[HistoryEntry]] = defaultdict(list)
    for name, psf in psfs:
        entry = HistoryEntry(name=name, psf=psf)
        by_camera[entry.camera].append(entry)
    return {
        serial: _compared(sorted(entries, key=lambda e: e.psf.captured_utc or ""))
        for serial, entries in sorted(by_camera.items())
    }


def history_document(history: dict[str, list[HistoryEntry]]) -> dict[str, Any]:
    """Return the history as plain lists and numbers."""
    return {
        "cameras": [
            {
                "serial": entries[0].serial,
                "lens": (entries[0].psf.labels or {}).get("lens"),
                **_focus(entries),
                "control_charts": [one.to_json() for one in _charts(entries)],
                "calibrations": [
                    {
                        "file": entry.name,
                        "captured_utc": entry.psf.captured_utc,
                        **{
                            key: getattr(entry.psf, key)
                            for key in (
                                "sigma_x_px",
                                "sigma_x_err_px",
                                "sigma_y_px",
                                "sigma_y_err_px",
                                "rho",
                                "rho_err",
                            )
                        },
                        "change": entry.verdict or None,
                    }
                    for entry in entries
                ],
            }
            for entries in history.values()
        ]
    }


def history_sections(history: dict[str, list[HistoryEntry]]) -> tuple[ReportSection, ...]:
    """Return one section for each camera."""
    return tuple(_camera_section(serial, entries) for serial, entries in history.items())


def _charts(entries: Sequence[HistoryEntry]) -> tuple[ControlChart, ...]:
    return control_charts([entry.psf for entry in entries])


def _focus(entries: Sequence[HistoryEntry]) -> dict[str, float | None]:
    """Repeatability of the focus between the calibrations, null where there are too few."""
    found = focus_repeatability([entry.psf for entry in entries])
    return {
        "focus_scatter_px2": None if found is None else found.scatter_px2,
        "focus_scatter_err_px2": None if found is None else found.scatter_err_px2,
    }


@in_report_style
def plot_history(entries: Sequence[HistoryEntry], ax: Axes | None = None) -> Figure | None:
    """Plot the total widths over time, with 95 % bars; None where fewer than two have a time."""
    dated = [entry for entry in entries if entry.psf.captured_utc is not None]
    if len(dated) < 2:
        return None
    axes = new_plot()[1] if ax is None else ax
    figure = figure_of(axes)
    axes.tick_params(axis="x", labelrotation=20)
    for key, colour in _COLOURS.items():
        points = [
            (
                datetime.fromisoformat(entry.captured_utc),
                getattr(entry.psf, key),
                NORMAL_95 * (getattr(entry.psf, key.replace("_px", "_err_px")) or 0.0),
            )
            for entry in dated
            if getattr(entry.psf, key) is not None
        ]
        if not points:
            continue
        moments, widths, errs = zip(*points, strict=True)
        axes.errorbar(
            moments,
            widths,
            yerr=errs,
            fmt="o-",
            markersize=4,
            linewidth=0.8,
            color=colour,
            label=key.removesuffix("_px").replace("_", " "),
        )
    axes.set(xlabel="captured (UTC)", ylabel="total sigma / px")
    if ax is None:
        figure.legend(loc="outside upper center", ncols=2)
    else:
        ax.legend(fontsize=8)
    return figure


def _compared(entries: list[HistoryEntry]) -> list[HistoryEntry]:
    done = entries[:1]
    for entry in entries[1:]:
        try:
            verdict = psf_change(entries[0].psf, entry.psf).verdict
        except CalibrationError as error:
            verdict = f"not comparable: {error}"
        done.append(HistoryEntry(name=entry.name, psf=entry.psf, verdict=verdict))
    return done


def _camera_section(serial: str, entries: list[HistoryEntry]) -> ReportSection:
    focus = focus_repeatability([entry.psf for entry in entries])
    charts = _charts(entries)
    return ReportSection.of(
        f"Camera {serial}",
        "Every calibration is compared with the first one of its camera.",
        None if focus is None else f"{str(focus).capitalize()}.",
        *(f"{str(chart).capitalize()}." for chart in charts),
        ReportTable.of(
            entries,
            {
                "file": lambda one: one.name,
                "captured (UTC)": lambda one: one.captured_utc[:19].replace("T", " "),
                "sigma x / px": lambda one: _width(one.psf.sigma_x_px, one.psf.sigma_x_err_px),
                "sigma y / px": lambda one: _width(one.psf.sigma_y_px, one.psf.sigma_y_err_px),
                "rho": lambda one: _width(one.psf.rho, one.psf.rho_err),
                "change": lambda one: one.verdict or "first",
            },
            ends_in_words=True,
        ),
        ReportFigure.if_drawn(
            plot_history(entries), "Total widths over time; bars are 95 % intervals."
        ),
        ReportFigure.of(
            _plot_charts(charts),
            "Control charts. Left: the calibrations with 95 % bars, their mean (before a drift) "
            "and three standard errors to either side. Right: cumulative sums of the differences "
            "from the mean of all before, over their errors, of rises and of falls; 1 in "
            f"{1 / FALSE_ALARMS:.0f} histories without a change passes a dashed line. Shaded: when "
            "a drift began.",
        )
        if charts
        else None,
    )


@in_report_style
def _plot_charts(charts: Sequence[ControlChart]) -> Figure:
    """Plot each parameter with its limits, and beside it the sums that are judged."""
    figure = new_figure(6.6, 2.1 * len(charts) + 0.4)
    panels: Any = figure.subplots(len(charts), 2, sharex=True, squeeze=False)
    for (values, sums), chart in zip(panels, charts, strict=True):
        moments: Any = [datetime.fromisoformat(one) for one in chart.captured_utc]
        errs = np.array(chart.errs)
        values.errorbar(
            moments,
            chart.values,
            yerr=NORMAL_95 * errs,
            fmt="o",
            markersize=3,
            linewidth=0.8,
            color=INK,
        )
        values.axhline(chart.centre, color=BLUE, linewidth=1.0)
        for side in (-3.0, 3.0):
            values.step(
                moments, chart.centre + side * errs, color=BLUE, linewidth=0.8, linestyle="--",
                where="mid",
            )  # fmt: skip
        values.set(ylabel=chart.parameter.replace("_px", " / px").replace("_", " "))
        for name, line, colour in (
            ("rises", chart.upwards, VERMILION),
            ("falls", chart.downwards, GREEN),
        ):
            sums.plot(moments, line, "o-", markersize=3, linewidth=1.0, color=colour, label=name)
        sums.axhline(chart.limit, color=INK, linewidth=0.8, linestyle="--")
        sums.set(ylabel="sum / standard errors", ylim=(0, None))
        if chart.drift is not None:
            for axes in (values, sums):
                axes.axvspan(
                    datetime.fromisoformat(chart.drift.after_utc),
                    datetime.fromisoformat(chart.drift.before_utc),
                    color=VERMILION,
                    alpha=0.12,
                )
    for axes in panels[-1]:
        axes.tick_params(axis="x", labelrotation=20)
    figure.legend(*panels[0][1].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _width(value: float | None, err: float | None) -> str:
    if value is None:
        return ""
    return with_reach(value, None if err is None else NORMAL_95 * err, 4)
