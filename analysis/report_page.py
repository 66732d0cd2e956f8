"""One HTML file that holds a whole report: text, tables and figures, nothing beside it."""

from base64 import b64encode
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO, StringIO
from typing import Literal

import matplotlib as mpl
from jinja2 import Environment, PackageLoader
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

__all__ = ["ReportFigure", "ReportSection", "ReportTable", "Verdict", "new_figure", "render_report"]

_STYLE = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "standoff",
    "svg.fonttype": "path",
}
_PNG_DPI = 110


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One headline figure: what it is, its value with unit, and how sure it is."""

    name: str
    value: str
    remark: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportTable:
    """A table; the first column is text, the others are figures."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigure:
    """A figure as markup that stands in the page itself, and what it shows."""

    markup: Markup
    caption: str

    @classmethod
    def of(
        cls, figure: Figure, caption: str, form: Literal["svg", "png"] = "svg"
    ) -> "ReportFigure":
        """Draw a matplotlib figure into the page: ``svg`` for lines, ``png`` for photographs."""
        with mpl.rc_context(_STYLE):
            if form == "svg":
                text = StringIO()
                figure.savefig(text, format="svg", metadata={"Date": None})
                markup = text.getvalue()
                markup = markup[markup.index("<svg") :]
            else:
                data = BytesIO()
                figure.savefig(data, format="png", dpi=_PNG_DPI)
                encoded = b64encode(data.getvalue()).decode("ascii")
                markup = f'<img alt="" src="data:image/png;base64,{encoded}">'
        return cls(markup=Markup(markup), caption=caption)  # noqa: S704 - matplotlib's own output


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSection:
    """A part of the report: what it says, in words, tables and figures."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    figures: tuple[ReportFigure, ...] = ()


def new_figure(width_in: float = 6.4, height_in: float = 3.2) -> Figure:
    """Return an empty figure in the report's style; it belongs to no window."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasAgg(figure)
        return figure


def render_report(
    *,
    title: str,
    subtitle: str,
    verdicts: tuple[Verdict, ...],
    sections: tuple[ReportSection, ...],
    provenance: tuple[tuple[str, str], ...],
    written: datetime | None = None,
) -> str:
    """Return the report as one HTML document that needs no other file and no network."""
    template = Environment(
        loader=PackageLoader("analysis", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    ).get_template("report.html")
    moment = (written or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")
    return template.render(
        title=title,
        subtitle=subtitle,
        verdicts=verdicts,
        sections=sections,
        provenance=provenance,
        written=moment,
    )
