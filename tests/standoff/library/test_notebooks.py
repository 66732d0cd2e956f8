"""Results in a notebook: a line, a table in which nothing is markup, a picture inline."""

import subprocess
import sys
from dataclasses import dataclass, is_dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import BaseModel

import standoff
from simulation.figures import InlineFigure
from simulation.notebook import Shown, html_table
from tests.standoff.library.every_result import RESULTS, result_of

LONGEST_LINE = 200
PLAIN = {"list_sessions", "show_session"}
"""Lists and mappings of Python's own, as the command prints them."""

DRAWN = {
    *("Bench.capture", "calibrate_geometry", "calibrate_psf", "d_prime_curves", "evaluate"),
    *("find_changes", "find_focus", "judge_homography", "judge_pose", "measure_curves"),
    *("measure_noise", "pose_limits", "psf_history", "read_image", "simulate", "simulate_pose"),
}
LISTED = {
    *("calibrate_geometry", "calibrate_psf", "compare_psfs", "d_prime_curves", "evaluate"),
    *("find_changes", "find_changes_of_series", "judge_poses", "measure_curves", "measure_lens"),
    "measure_noise",
    *("plan_study", "preview_plan", "psf_history", "score_benchmark", "validate", "verify_session"),
    "write_noise",
}


def one_of(name: str) -> Any:
    """A result, or the first of several."""
    found = result_of(name)
    return found[0] if isinstance(found, tuple) else found


class Cells(HTMLParser):
    """The tags of a table, and whether it has a filled cell."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.add(tag)

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(RESULTS.keys() - PLAIN))
def test_a_result_is_read_at_a_glance(there: Path, name: str) -> None:
    one = one_of(name)
    assert len(repr(one)) <= LONGEST_LINE
    assert "\n" not in repr(one)
    cells = Cells()
    cells.feed(one._repr_html_())
    assert cells.tags <= {"table", "caption", "tr", "th", "td"}
    assert {"table", "tr"} <= cells.tags
    assert len([text for text in cells.texts if text.strip()]) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(RESULTS.keys() - PLAIN))
def test_nothing_in_a_table_is_markup(there: Path, name: str) -> None:
    one = one_of(name)
    evil = "<script>alert(1)</script>"
    if isinstance(one, BaseModel):
        names = [key for key in type(one).model_fields if isinstance(getattr(one, key), str)]
        one = one.model_copy(update=dict.fromkeys(names, evil))
    elif is_dataclass(one) and not isinstance(one, type):
        kept = {key: getattr(one, key) for key in one.__dataclass_fields__}
        named = {key: evil for key, value in kept.items() if isinstance(value, str)}
        paths = {key: Path(evil) for key, value in kept.items() if isinstance(value, Path)}
        one = replace(one, **named, **paths)
    assert "<script" not in one._repr_html_()


@pytest.mark.slow
def test_what_can_be_drawn_or_listed_is(there: Path) -> None:
    made = {name: one_of(name) for name in RESULTS}
    assert {name for name, one in made.items() if hasattr(one, "plot")} == DRAWN
    assert {name for name, one in made.items() if hasattr(one, "to_dataframe")} == LISTED


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LISTED))
def test_a_list_is_a_table_of_pandas(there: Path, name: str) -> None:
    pytest.importorskip("pandas")
    table = one_of(name).to_dataframe()
    assert len(table) > 0
    assert len(table.columns) > 1


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(DRAWN))
def test_a_result_is_drawn_into_axes_or_into_a_figure_of_its_own(there: Path, name: str) -> None:
    one = dated_history() if name == "psf_history" else one_of(name)
    figure = Figure()
    beside, given = figure.subplots(1, 2)
    windows = plt.get_fignums()
    assert one.plot(ax=given) is figure
    assert given.has_data()
    assert given.get_xlabel() or given.images
    assert not beside.has_data()
    alone = one.plot()
    assert isinstance(alone, InlineFigure)
    assert any(axes.has_data() for axes in alone.axes)
    assert alone._repr_png_().startswith(b"\x89PNG\r\n")
    assert plt.get_fignums() == windows


def dated_history() -> Any:
    """Two calibrations that say when they were captured: files of a session do."""
    psf = result_of("calibrate_psf")
    for number in (1, 2):
        known = psf.model_copy(update={"captured_utc": f"2026-03-0{number}T10:00:00+00:00"})
        standoff.write_psf(f"dated-{number}.json", known)
    return standoff.psf_history(["dated-1.json", "dated-2.json"])


@pytest.mark.slow
def test_a_figure_is_drawn_within_a_part_of_a_figure(there: Path) -> None:
    whole = Figure()
    left = whole.subfigures(1, 2, squeeze=False)[0, 0]
    axes = left.subplots()
    assert result_of("judge_pose").plot(axes) is whole
    assert axes.images


def test_a_fresh_kernel_shows_a_figure_without_pyplot() -> None:
    code = (
        "import sys, numpy, standoff\n"
        "photograph = standoff.simulate(numpy.ones((64, 64)), zoom=2, "
        "psf=standoff.GaussianPsf(sigma_px=0.7))\n"
        "figure = photograph.plot()\n"
        "assert figure._repr_png_()[:4] == b'\\x89PNG'\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_kernel_with_ipython_shows_one_picture() -> None:
    formatters = pytest.importorskip("IPython.core.formatters")
    shown, _ = formatters.DisplayFormatter().format(InlineFigure())
    assert shown["image/png"]


@dataclass(frozen=True, kw_only=True, repr=False)
class Measured(Shown):
    name: str
    sigma_px: float
    map: NDArray[np.float64]
    edges: tuple[str, ...]
    missing: float | None = None


def test_a_line_says_what_there_is_and_is_cut() -> None:
    one = Measured(name="a\nb", sigma_px=1 / 3, map=np.ones((2, 3)), edges=tuple("abcdefg"))
    assert repr(one) == (
        "<Measured: name a b; sigma px 0.333333; map 2 x 3 float64; edges 7 of them>"
    )
    assert str(one) == repr(one)
    assert len(repr(replace(one, name="n" * 5000, edges=("e" * 999,)))) <= LONGEST_LINE
    assert "<td>&lt;b&gt;</td>" in replace(one, name="<b>")._repr_html_()
    assert html_table("<b>", ("<b>",), [("<b>",)]).count("&lt;b&gt;") == 3
