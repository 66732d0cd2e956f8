import re
from dataclasses import replace

import pytest
from markupsafe import Markup

from analysis.reports import (
    Report,
    ReportSection,
    in_report_style,
    new_figure,
    png_bytes,
)
from analysis.reports._page import CONVENTION, ReportFigure, ReportFront, ReportTable, Verdict
from tests.analysis.html_page import Page

NASTY = '<script src="https://example.org/x.js">alert("µ & co")</script>'


def line_figure() -> ReportFigure:
    figure = new_figure()
    figure.subplots().plot([0, 1], [0, 1], label="a line")
    return ReportFigure.of(figure, "A line.")


def report(
    *sections: ReportSection,
    title: str = "Session",
    remark: str = "",
    front: ReportFront | None = None,
) -> str:
    return Report(
        title=title,
        subtitle="bench 1",
        verdicts=(Verdict("total sigma x", "0.7990 px", remark),),
        sections=sections,
        provenance=(("Python", "3.11.0"),),
        front=front,
    ).html()


@pytest.mark.slow
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
    assert "Figure 1: A photograph." in page.texts


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


def test_a_section_that_may_be_folded_begins_open_so_that_paper_shows_it() -> None:
    folded = ReportSection(title="All edges", is_folded=True, text=("12 edges.",))
    assert "<details open>" in report(folded)
    assert "details" not in Page(report(ReportSection(title="All edges"))).tags


def test_a_long_report_lists_its_sections_and_every_line_leads_to_its_own() -> None:
    titles = ["One", "Two", "Three", "4 < 5", "Five", "Six"]
    document = report(*(ReportSection(title=title) for title in titles))
    listed = re.findall(r'<a href="#([\w-]+)">(.*?)</a>', document)
    headed = re.findall(r'<section id="([\w-]+)".*?<h2>(.*?)</h2>', document, re.DOTALL)
    assert [title for _, title in listed] == [str(Markup.escape(title)) for title in titles]
    assert listed == headed
    assert "nav" not in Page(report(*(ReportSection(title=title) for title in titles[1:]))).tags


def test_figures_are_numbered_through_all_sections() -> None:
    tables = (ReportTable(columns=("a",), rows=(("b",),)),)
    document = report(
        ReportSection(title="One", figures=(line_figure(),) * 3),
        ReportSection(title="Two", figures=(line_figure(),), tables=tables),
        ReportSection(title="Three", figures=(line_figure(),), is_folded=True),
    )
    numbers = re.findall(r"<figcaption>Figure (\d+): ", document)
    assert numbers == ["1", "2", "3", "4", "5"]


def test_a_figure_is_printed_at_the_size_it_was_drawn_at() -> None:
    figure = ReportFigure.of(new_figure(5.25, 2.0), "Small.")
    assert 'style="width: 5.25in"' in report(ReportSection(title="S", figures=(figure,)))


@pytest.mark.parametrize(
    ("widths_in", "count"), [((7.2,), 1), ((3.6, 3.6, 3.6), 2), ((6.4, 6.4), 1)]
)
def test_a_title_is_kept_with_the_figures_of_its_first_row(
    widths_in: tuple[float, ...], count: int
) -> None:
    figures = tuple(ReportFigure.of(new_figure(width, 2.0), "F.") for width in widths_in)
    section = ReportSection(title="Title", figures=figures)
    assert section.figures_of_first_row == count
    together = re.search(
        r'<div class="together">(.*?)</figure>\s*</div>\s*</div>', report(section), re.S
    )
    assert together is not None
    assert together[1].count("<figcaption>") == count


def test_the_front_has_verdict_facts_and_every_warning() -> None:
    front = ReportFront(
        outcome="unsure",
        verdict="1 limit of l.toml: 1 unsure.",
        facts=(("lens", "Kowa & co"), ("f-number", "f/4")),
        warnings=("white is clipped", "JPEG <q 75>"),
    )
    page = Page(report(ReportSection(title="All"), front=front))
    for text in ("unsure", "1 limit of l.toml: 1 unsure.", "lens", "Kowa & co", "f/4", "Warnings"):
        assert text in page.texts
    assert page.texts.index("white is clipped") < page.texts.index("JPEG <q 75>")
    bare = replace(front, outcome="none", warnings=())
    texts = Page(report(ReportSection(title="All"), front=bare)).texts
    assert "1 limit of l.toml: 1 unsure." not in texts
    assert "No warnings" in texts


@pytest.mark.slow
def test_on_paper_no_text_is_below_8_points_and_no_title_parted_from_its_figure() -> None:
    weasyprint = pytest.importorskip("weasyprint")
    many = ReportTable(columns=("edge", "sigma"), rows=(("a", "0.8 ± 0.1"),) * 90, caption="C.")
    sections = [
        ReportSection(title=f"Section {k}", text=("Words. " * 30,), figures=(line_figure(),) * 2)
        for k in range(4)
    ]
    sections.append(ReportSection(title="All edges", tables=(many,), is_folded=True))
    front = ReportFront(
        outcome="none", verdict="None.", facts=(("lens", "L"),), warnings=("beware",)
    )
    document = weasyprint.HTML(string=report(*sections, front=front)).render()
    sizes, last_titles, cells = [], [], 0
    for page in document.pages:
        boxes = [box for box in page._page_box.descendants() if type(box).__name__ == "TextBox"]
        sizes += [box.style["font_size"] * 0.75 for box in boxes if box.text.strip()]
        body = [b for b in boxes if b.element_tag not in ("@bottom-left", "@bottom-right")]
        last_titles.append(max(body, key=lambda box: box.position_y).element_tag == "h2")
        cells += sum(box.text == "0.8 ± 0.1" for box in boxes)
    assert min(sizes) >= 8.0 - 1e-9
    assert not any(last_titles)
    assert cells == 90  # nothing is folded away


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


def test_a_report_says_once_at_its_top_how_sure_its_figures_are() -> None:
    page = Page(report(ReportSection(title="All", text=("Known to 5 %.",))))
    assert page.texts.count(CONVENTION.replace(" %", "\u00a0%")) == 1
    assert "Known to 5\u00a0%." in page.texts  # a number stays with its sign
    bare = Report(title="S", subtitle="", sections=(), provenance=(), has_uncertainties=False)
    assert "Uncertainties" not in bare.html()


@pytest.mark.slow
@pytest.mark.parametrize("lines", range(28, 44, 3))
def test_a_short_table_is_on_the_page_of_its_title(lines: int) -> None:
    weasyprint = pytest.importorskip("weasyprint")
    rows = tuple((f"row {k}", "1") for k in range(6))
    table = ReportTable(columns=("edge", "sigma"), rows=rows)
    sections = (
        ReportSection(title="Before", text=("Words.",) * lines),
        ReportSection(title="Widths", text=("What they are.",), tables=(table,)),
    )
    pages = []
    for number, page in enumerate(weasyprint.HTML(string=report(*sections)).render().pages):
        boxes = page._page_box.descendants()
        pages += [
            number
            for box in boxes
            if type(box).__name__ == "TextBox" and (box.text == "Widths" or "row " in box.text)
        ]
    assert len(pages) == 7
    assert len(set(pages)) == 1


def test_a_row_of_one_cell_is_the_title_of_those_below() -> None:
    table = ReportTable(columns=("edge", "sigma"), rows=(("a.tif",), ("(1, 2)", "0.8")))
    document = report(ReportSection(title="All", tables=(table,)))
    assert '<th colspan="2">a.tif</th>' in document
