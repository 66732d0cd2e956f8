"""One self-contained HTML file with a whole report: text, tables and figures."""

import warnings
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeAlias, TypeVar

import matplotlib as mpl
from jinja2 import Environment, PackageLoader
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from acquisition.files import Provenance, write_file
from simulation.figures import InlineFigure

_P = ParamSpec("_P")
_T = TypeVar("_T")

_STYLE: Any = {
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
_PNG_DPI = 170
_PNG_COMPRESSION = 4  # half of the time of 6, and files 6 % larger
_INPUTS_LISTED = 50
_UNBROKEN_ROWS = 8  # of a table that no page break parts: an inch and a half
_COLUMN_IN = 7.32  # A4 less its margins
_GAP_IN = 0.08
_LISTED_SECTIONS = 6  # fewer are soon seen
_WIDE_COLUMNS = 11  # that fit on the short side of A4 at 8 pt


CONVENTION = "Uncertainties are 95 % intervals: ± gives half the width, bars and bands all of it."


@dataclass(frozen=True, slots=True)
class Verdict:
    """One headline figure: what it is, its value with unit, and its uncertainty."""

    name: str
    value: str
    remark: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportTable:
    """A table; the first column is text, the others are figures, but for a last one of words.

    A row of a single cell is the title of those below it. ``links`` are addresses for the first
    cells of the rows, empty where there is none; ``is_of_changes`` says that the rows are the
    numbered changes of the section's views, which the page's script shows when a row is clicked.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    ends_in_words: bool = False
    links: tuple[str, ...] = ()
    is_of_changes: bool = False

    @classmethod
    def of(
        cls,
        items: Iterable[_T],
        cells: Mapping[str, Callable[[_T], str]],
        caption: str = "",
        *,
        ends_in_words: bool = False,
    ) -> "ReportTable":
        """Make a row of each item, by columns that say what stands in them."""
        rows = tuple(tuple(cell(one) for cell in cells.values()) for one in items)
        return cls(columns=tuple(cells), rows=rows, caption=caption, ends_in_words=ends_in_words)

    @property
    def is_short(self) -> bool:
        """Whether it stays on one page; rows of words may take half a page and may be parted."""
        return len(self.rows) <= _UNBROKEN_ROWS and not self.ends_in_words


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigure:
    """A figure as markup embedded in the page, and its caption.

    It is printed ``width_in`` inches wide, the size it was drawn at, so that its text has the size
    it was given. The page numbers its figures and writes the number before the caption.
    """

    markup: Markup
    caption: str
    width_in: float = 6.4

    @classmethod
    def of(
        cls, figure: Figure, caption: str, form: Literal["svg", "png"] = "svg"
    ) -> "ReportFigure":
        """Render a matplotlib figure for the page: ``svg`` for lines, ``png`` for photographs."""
        width_in = float(figure.get_figwidth())
        if form == "png":
            return cls.of_png(png_bytes(figure), caption, width_in)
        markup = svg_bytes(figure).decode("utf-8")
        safe = Markup(markup[markup.index("<svg") :])  # noqa: S704 - matplotlib's own output
        return cls(markup=safe, caption=caption, width_in=width_in)

    @classmethod
    def if_drawn(cls, figure: Figure | None, caption: str) -> "ReportFigure | None":
        """Render a figure where there is one."""
        return None if figure is None else cls.of(figure, caption)

    @classmethod
    def of_png(cls, data: bytes, caption: str, width_in: float) -> "ReportFigure":
        """Embed a PNG file."""
        encoded = b64encode(data).decode("ascii")
        markup = Markup(f'<img alt="" src="data:image/png;base64,{encoded}">')  # noqa: S704 - base64
        return cls(markup=markup, caption=caption, width_in=width_in)


Part: TypeAlias = str | ReportTable | ReportFigure | None
"""What a section says: a sentence, a table, a figure, or nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSection:
    """A section of the report: text, tables and figures.

    A reader may fold a foldable section away on the screen; it begins open, and paper shows it.
    The figures of a section that ``has_views`` are views of one frame, which the page's script
    links and blinks.
    """

    title: str
    is_folded: bool = False
    has_views: bool = False
    text: tuple[str, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    figures: tuple[ReportFigure, ...] = ()

    @classmethod
    def of(
        cls, title: str, *parts: Part, is_folded: bool = False, has_views: bool = False
    ) -> "ReportSection":
        """Make a section of its sentences, tables and figures, each kind in its order."""
        return cls(
            title=title,
            is_folded=is_folded,
            has_views=has_views,
            text=tuple(part for part in parts if isinstance(part, str)),
            tables=tuple(part for part in parts if isinstance(part, ReportTable)),
            figures=tuple(part for part in parts if isinstance(part, ReportFigure)),
        )

    @property
    def is_wide(self) -> bool:
        """Whether a table needs the long side of the paper."""
        return any(len(table.columns) > _WIDE_COLUMNS for table in self.tables)

    @property
    def figures_of_first_row(self) -> int:
        """How many figures stand side by side under the title: it is never parted from them."""
        width_in = count = 0.0
        for figure in self.figures:
            width_in += figure.width_in + _GAP_IN * (count > 0)
            if count and width_in > _COLUMN_IN:
                break
            count += 1
        return int(count)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFront:
    """What a reader needs first: the verdict, what was measured with what, and what to beware of.

    ``outcome`` is pass, fail, unsure, or none without limits; ``verdict`` says it in a sentence
    after ``label``, by default the outcome itself. Without limits and a label there is no banner.
    """

    outcome: Literal["pass", "fail", "unsure", "none"]
    verdict: str
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...] = ()
    label: str = ""

    @property
    def has_banner(self) -> bool:
        """Whether there is a verdict to show."""
        return self.outcome != "none" or bool(self.label)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The content of a report, in the order of the page.

    ``verdicts`` are the headline figures, ``provenance`` are names and values for the table at the
    end, ``origin`` is the provenance of the document that is reported: in the header, and its files
    in the table, ``inputs_listed`` at most. A report that ``has_uncertainties`` says under its
    title that all are at 95 %.
    """

    title: str
    subtitle: str
    sections: tuple[ReportSection, ...]
    provenance: tuple[tuple[str, str], ...]
    verdicts: tuple[Verdict, ...] = ()
    origin: Provenance | None = None
    front: ReportFront | None = None
    has_uncertainties: bool = True
    inputs_listed: int = _INPUTS_LISTED

    @property
    def has_views(self) -> bool:
        """Whether a section shows linked views, which the page then has a script for."""
        return any(section.has_views for section in self.sections)

    @property
    def has_contents(self) -> bool:
        """Whether the page, on a screen, lists its sections first."""
        return len(self.sections) >= _LISTED_SECTIONS

    def html(self) -> str:
        """Return the report as one HTML document that needs no other file and no network."""
        environment = _environment()
        environment.filters["unbroken"] = _unbroken
        return environment.get_template("report.html").render(
            report=self,
            script=Markup(views_script()),  # noqa: S704 - a file of this package
            convention=CONVENTION if self.has_uncertainties else "",
            provenance=(*_inputs(self.origin, self.inputs_listed), *self.provenance),
            encodings=encodings_text(self.origin),
            written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        )


def present(*those: _T | None) -> tuple[_T, ...]:
    """Return those that are there."""
    return tuple(one for one in those if one is not None)


def moment_text(written: str) -> str:
    """Return a time as people read it: of Exif in the camera's own time, of ours in UTC."""
    day, _, time = written.replace(" ", "T").partition("T")
    zone = " UTC" if time.endswith(("Z", "+00:00")) else ""
    return f"{day.replace(':', '-')} {time[:5]}{zone}" if time else written


def number_text(value: float | None, form: str, unknown: str = "", unit: str = "") -> str:
    """Return a number in a format, with its unit; ``unknown`` of none."""
    return unknown if value is None else f"{value:{form}}{unit}"


def as_sentence(text: str) -> str:
    """Return what is said as a sentence of its own."""
    return f"{text[0].upper()}{text[1:]}."


def in_report_style(draw: Callable[_P, _T]) -> Callable[_P, _T]:
    """Decorate a drawing function: its figure takes the report's style."""

    @wraps(draw)
    def draw_in_style(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        with mpl.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return draw_in_style


def new_figure(width_in: float = 6.4, height_in: float = 3.2) -> Figure:
    """Return an empty figure that belongs to no window."""
    return InlineFigure(figsize=(width_in, height_in), layout="constrained")


def new_plot(width_in: float = 6.4, height_in: float = 3.2) -> tuple[Figure, Axes]:
    """Return an empty figure of one plot, and its axes."""
    figure = new_figure(width_in, height_in)
    return figure, figure.subplots()


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure: as SVG if the file's suffix says so, else as PNG."""
    write_file(path, svg_bytes(figure) if path.suffix.lower() == ".svg" else png_bytes(figure))


def png_bytes(figure: Figure) -> bytes:
    """Draw a figure as a PNG file."""
    data = BytesIO()
    with _drawing():
        _lay_out(figure)
        figure.savefig(
            data, format="png", dpi=_PNG_DPI, pil_kwargs={"compress_level": _PNG_COMPRESSION}
        )
    return data.getvalue()


def svg_bytes(figure: Figure) -> bytes:
    """Draw a figure as an SVG file."""
    data = BytesIO()
    with _drawing():
        _lay_out(figure)
        figure.savefig(data, format="svg", metadata={"Date": None})
    return data.getvalue()


@contextmanager
def _drawing() -> Iterator[None]:
    """Draw in the report's style; names of files may have letters that its font lacks."""
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield


def _lay_out(figure: Figure) -> None:
    """Lay a figure out once; matplotlib draws it whole for that, before every file."""
    engine = figure.get_layout_engine()
    if figure.axes and engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def views_script() -> str:
    """Return the script of pages with linked views, exactly as it stands between their tags.

    Whoever serves such a page in a sandbox tells it by this from any other script.
    """
    return f"\n{_environment().get_template('views.js').render()}\n"


def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("analysis.reports", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _unbroken(text: str) -> str:
    """Keep a number and its per cent sign on one line."""
    return text.replace(" %", "\u00a0%")


def _inputs(origin: Provenance | None, most: int) -> tuple[tuple[str, str], ...]:
    files = () if origin is None else origin.inputs
    rows = [(file.path, f"sha256 {file.sha256}") for file in files[:most]]
    if len(files) > most:
        rows.append(("and more", f"{len(files) - most} files, listed in the JSON file"))
    return tuple(rows)


def encodings_text(origin: Provenance | None) -> str:
    """Return how the levels of the photographs were read; empty where it is not known."""
    if origin is None:
        return ""
    return origin.encoding if isinstance(origin.encoding, str) else ", ".join(origin.encoding)
