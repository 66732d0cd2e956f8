import re

import pytest
from markupsafe import Markup

from analysis.reports.page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    new_figure,
    png_bytes,
    render_report,
)
from tests.analysis.html_page import Page

NASTY = '<script src="https://example.org/x.js">alert("µ & co")</script>'


def line_figure() -> ReportFigure:
    figure = new_figure()
    figure.subplots().plot([0, 1], [0, 1], label="a line")
    return ReportFigure.of(figure, "A line.")


def report(*sections: ReportSection, title: str = "Session", remark: str = "") -> str:
    return render_report(
        title=title,
        subtitle="bench 1",
        verdicts=(Verdict(name="total sigma x", value="0.7990 px", remark=remark),),
        sections=sections,
        provenance=(("Python", "3.11.0"),),
    )


def test_a_report_fetches_nothing() -> None:
    figure = new_figure()
    figure.subplots().imshow([[0, 1], [1, 0]])
    photograph = ReportFigure.of(figure, "A photograph.", form="png")
    page = Page(report(ReportSection(title="All", figures=(line_figure(), photograph))))
    assert page.fetched == []
    assert not {"script", "link", "iframe", "object", "base"} & set(page.tags)


def test_a_style_loads_no_font_and_no_other_style() -> None:
    document = report(ReportSection(title="All"))
    assert "@import" not in document
    assert "url(" not in document


def test_lines_are_drawn_as_svg_and_photographs_as_png() -> None:
    lines = Page(report(ReportSection(title="Lines", figures=(line_figure(),))))
    assert "svg" in lines.tags
    assert "img" not in lines.tags
    photograph = ReportFigure.of(new_figure(), "A photograph.", form="png")
    page = Page(report(ReportSection(title="Photographs", figures=(photograph,))))
    assert [link[:22] for link in page.links] == ["data:image/png;base64,"]
    assert "A photograph." in page.texts


def test_text_is_escaped_wherever_it_stands() -> None:
    section = ReportSection(
        title=NASTY,
        text=(NASTY,),
        tables=(ReportTable(columns=("a", NASTY), rows=((NASTY, "1"),), caption=NASTY),),
        figures=(ReportFigure(markup=Markup("<svg></svg>"), caption=NASTY),),
    )
    document = report(section, title=NASTY, remark=NASTY)
    page = Page(document)
    assert "script" not in page.tags
    assert page.fetched == []
    # Title twice, remark, section title, paragraph, column, cell, table and figure caption.
    assert page.text.count(NASTY) == 9


def test_a_table_holds_its_cells_in_order() -> None:
    table = ReportTable(columns=("name", "MSE"), rows=(("paper", "1.04"), ("matched", "0.60")))
    texts = Page(report(ReportSection(title="Table", tables=(table,)))).texts
    start = texts.index("name")
    assert texts[start : start + 6] == ["name", "MSE", "paper", "1.04", "matched", "0.60"]


def test_a_folded_section_waits_to_be_opened() -> None:
    folded = ReportSection(title="All edges", is_folded=True, text=("12 edges.",))
    assert "details" in Page(report(folded)).tags
    assert "details" not in Page(report(ReportSection(title="All edges"))).tags


def test_the_page_says_when_and_with_what_it_was_written() -> None:
    page = Page(report(ReportSection(title="All")))
    assert any(re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", text) for text in page.texts)
    assert "3.11.0" in page.texts
    assert page.headings == ["Session", "All", "Where this comes from"]


def test_a_figure_is_the_same_text_each_time() -> None:
    assert line_figure().markup == line_figure().markup


def test_a_png_begins_as_one() -> None:
    assert png_bytes(new_figure()).startswith(b"\x89PNG\r\n\x1a\n")


@pytest.mark.parametrize("size_in", [(6.4, 3.2), (4.0, 7.0)])
def test_a_figure_has_the_size_asked_for(size_in: tuple[float, float]) -> None:
    assert tuple(new_figure(*size_in).get_size_inches()) == size_in


def test_the_style_ends_with_the_drawing() -> None:
    @in_report_style
    def drawn_with_grid() -> bool:
        axes = new_figure().subplots()
        return axes.xaxis.get_gridlines()[0].get_visible()

    assert drawn_with_grid()
    assert not new_figure().subplots().xaxis.get_gridlines()[0].get_visible()
