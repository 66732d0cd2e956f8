"""The pages on changes, made from results put together by hand."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from acquisition.photographs import on_screen, white_level_dn
from analysis.change_series import (
    ChangesSeries,
    ChangeTimeLine,
    ChangeTrack,
    ComparedFollowup,
    TimeLineFollowup,
    TrackPoint,
)
from analysis.changes import FilterWidth, describe_focus
from analysis.changes._document import ChangeSummary
from analysis.changes._filter import ChangeMasks, ChangeResult
from analysis.changes._plot import changes_figure
from analysis.reports import (
    ColourPair,
    changes_report,
    compared_pictures,
    q_text,
    series_report,
    view_figures,
)
from analysis.reports._change_pictures import LONGEST_SIDE_PX
from analysis.reports._change_series import plot_track_map
from simulation.arrays import BoolArray, FloatArray
from tests.analysis.changes.compared_fields import at_rest, change_at
from tests.analysis.html_page import Page

SHAPE = (60, 80)
CHANGES = tuple(
    change_at(x, y, amplitude) for x, y, amplitude in ((20.0, 30.0, 12.0), (70.0, 2.0, -9.0))
)


def summary(**others: Any) -> ChangeSummary:
    values: dict[str, Any] = {
        "reference": "before.tif",
        "followup": "after.tif",
        "homography": np.eye(3).tolist(),
        "distortion_k1": 0.0,
        "distortion_k1_err": None,
        "zoom": 1.0,
        "changed_px": 18,
        "compared_px": 4000,
        "threshold_sd": 4.9,
        "false_alarms_px": 0.05,
        "gain": 1.0,
        "extra_blur_px2": 0.0,
        "extra_blur_err_px2": 0.01,
        "noise_factor": 1.0,
        "is_noise_known": False,
        "registration_err_px": 0.0,
        "width_err_px2": 0.0,
        "changes": CHANGES,
        "kernel": "pair",
    }
    return ChangeSummary.model_validate(values | others)


def result(
    after_dn: FloatArray,
    clipped: BoolArray | None = None,
    shift_px: tuple[float, float] = (0.0, 0.0),
) -> ChangeResult:
    """A comparison whose pose is a shift of ``(x, y)``."""
    valid = np.ones(after_dn.shape, np.bool_)
    none = np.zeros(after_dn.shape)
    matrix = np.array([[1.0, 0, shift_px[0]], [0, 1, shift_px[1]], [0, 0, 1]])
    shape = (after_dn.shape[0], after_dn.shape[1])
    return ChangeResult(
        summary=summary(),
        followup_dn=after_dn,
        difference_dn=none,
        plain_difference_dn=none,
        pose_difference_dn=none,
        variance_dn2=none + 1.0,
        significance=none,
        limit_dn=none + 4.0,
        is_change=~valid,
        is_moved=~valid,
        valid=valid,
        pose=at_rest(shape, matrix),
        masks=ChangeMasks(
            is_change=~valid,
            valid=valid,
            clipped=~valid if clipped is None else clipped,
            reference_clipped=~valid,
        ),
        filter_widths=(FilterWidth(width_px=1.0),),
    )


def decoded(data: bytes) -> np.ndarray[Any, Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))


def test_both_photographs_lie_on_one_grid_in_one_light() -> None:
    y, x = np.indices(SHAPE)
    before = 100 + 40 * np.sin(x / 6.0) * np.cos(y / 5.0)
    # The follow-up's pixel (x, y) shows the reference's (x + 4, y + 2), twice as bright.
    after = 2 * (100 + 40 * np.sin((x + 4) / 6.0) * np.cos((y + 2) / 5.0)) + 30
    found = result(after, shift_px=(4.0, 2.0))
    pictures = compared_pictures(before, found, None)
    shown = [decoded(one).astype(float) for one in (pictures.before, pictures.after)]
    inside = np.s_[2:-4, 2:-6]
    # JPEG of quality 92 leaves one or two levels.
    assert np.abs(shown[0] - shown[1])[inside].max() < 8
    assert shown[1].std() > 40


def coloured(levels: FloatArray, hue: tuple[float, float, float]) -> FloatArray:
    return np.asarray(levels[:, :, np.newaxis] * np.array(hue))


def test_photographs_in_colour_keep_their_hues_whatever_their_light() -> None:
    # Worked example: the follow-up is half as bright, and a disc of it is green instead of orange.
    y, x = np.indices(SHAPE)
    levels = 100 + 40 * np.sin(x / 6.0) * np.cos(y / 5.0)
    before = coloured(levels, (1.0, 0.5, 0.1))
    after = 0.5 * before
    distance = np.hypot(x - 40, y - 30)
    disc, away = distance < 6, np.abs(distance - 6) > 8  # an edge rings over a block of JPEG
    after[disc] = 0.5 * coloured(levels, (0.2, 1.0, 0.1))[disc]
    found = result(after.mean(2))
    pair = ColourPair(reference_dn=before, followup_dn=after)
    pictures = compared_pictures(before.mean(2), found, None, pair)
    assert pictures.is_colour
    shown = [decoded(one)[..., ::-1].astype(float) for one in (pictures.before, pictures.after)]
    assert [one.shape for one in shown] == [(*SHAPE, 3)] * 2
    white_dn = white_level_dn(after)
    # As sRGB stores them, with one white for all channels; JPEG leaves a few levels.
    expected = 255 * on_screen(after, white_dn)
    np.testing.assert_allclose(shown[1][away], expected[away], atol=8)
    red, green, _ = shown[1][disc].mean(0)
    assert green > 1.5 * red
    # The earlier one is made as bright as the later one, by one factor: the disc makes it darker.
    gain = after.mean() / before.mean()
    np.testing.assert_allclose(shown[0], 255 * on_screen(gain * before, white_dn), atol=8)
    captions = [one.caption for one in view_figures(pictures, CHANGES, (SHAPE[1], SHAPE[0]))]
    assert "its hues are its own" in captions[0]


def test_a_change_of_one_pixel_keeps_its_colour_in_the_page() -> None:
    before = coloured(np.full(SHAPE, 100.0), (1.0, 1.0, 1.0))
    after = before.copy()
    after[31, 41] = (20.0, 20.0, 100.0)
    found = result(after.mean(2))
    pair = ColourPair(reference_dn=before, followup_dn=after)
    blue, _, red = decoded(compared_pictures(before.mean(2), found, None, pair).after)[31, 41]
    # sRGB of 0.2 and of 1 are 124 and 255; colours of half the resolution would mix four pixels.
    assert int(blue) - int(red) > 100


@pytest.mark.parametrize("is_colour", [False, True])
def test_a_large_photograph_is_averaged_down_for_the_page(is_colour: bool) -> None:
    levels = np.random.default_rng(0).normal(100, 10, (40, 2 * LONGEST_SIDE_PX + 5))
    after = coloured(levels, (1.0, 0.6, 0.3))
    pair = ColourPair(reference_dn=after, followup_dn=after) if is_colour else None
    pictures = compared_pictures(levels, result(levels), None, pair)
    sizes = {decoded(one).shape[1] for one in (pictures.before, pictures.after, pictures.masks)}
    assert sizes == {-(-levels.shape[1] // 3)}


def test_the_figure_shows_a_follow_up_in_colour_in_its_colours() -> None:
    y, x = np.indices(SHAPE)
    after = coloured(100 + 40 * np.sin(x / 6.0) * np.cos(y / 5.0), (1.0, 0.5, 0.1))
    found = result(after.mean(2))
    for colours_dn, channels in ((None, 2), (after, 3)):
        drawn = np.asarray(changes_figure(found, colours_dn).axes[0].images[0].get_array())
        assert drawn.ndim == channels
    np.testing.assert_allclose(drawn, on_screen(after, white_level_dn(after)))


def test_masks_are_drawn_where_they_are_and_nowhere_else() -> None:
    clipped, left_out = np.zeros(SHAPE, np.bool_), np.zeros(SHAPE, np.bool_)
    clipped[10:15, 20:30] = True
    left_out[40:50, 5:9] = True
    after = np.random.default_rng(0).normal(100, 10, SHAPE)
    pictures = compared_pictures(after, result(after, clipped), left_out)
    opacity = decoded(pictures.masks)[..., 3]
    np.testing.assert_array_equal(opacity > 0, clipped | left_out)


def page(**others: Any) -> tuple[str, Page]:
    after = np.random.default_rng(0).normal(100, 10, SHAPE)
    pictures = compared_pictures(after, result(after), None)
    document = changes_report(
        summary(**others), view_figures(pictures, CHANGES, (SHAPE[1], SHAPE[0]))
    ).html()
    return document, Page(document)


def test_the_page_needs_no_other_file_and_says_the_warnings_first() -> None:
    document, seen = page(warnings=("the texture repeats: <b>beware</b>",))
    assert seen.fetched == []
    assert seen.headings[:2] == ["Changes", "Before and after"]
    assert "the texture repeats: <b>beware</b>" in seen.texts
    assert document.index("the texture repeats") < document.index("Before and after")
    assert document.count("<svg data-view") == 3
    # Above its ring, but below one at the upper border.
    assert document.count('data-change="1"') == 3
    assert "2 changes" in seen.text


def test_a_page_without_changes_says_so() -> None:
    _, seen = page(changes=(), changed_px=0)
    assert "no change" in seen.text
    assert "No warnings" in seen.text


@pytest.mark.parametrize(
    ("kernel", "extra_px2", "said"),
    [
        ("both", 0.25, "the focus has changed: against psf.json and the pose, the follow-up is so"),
        (
            "both",
            -0.25,
            "the focus has changed: against psf.json and the pose, the follow-up is sh",
        ),
        ("calibrated", 0.01, "no change of focus: the blur is what psf.json and the pose explain"),
        ("pair", 0.25, "against the reference, the follow-up is softer by a Gaussian of 0.50 px"),
        ("pair", 0.01, "the follow-up is as sharp as the reference (+0.010 ± 0.020 px^2)"),
    ],
)
def test_the_focus_is_told_with_its_significance(kernel: str, extra_px2: float, said: str) -> None:
    sentence = describe_focus(summary(kernel=kernel, extra_blur_px2=extra_px2))
    assert sentence is not None
    assert sentence.startswith(said)
    if abs(extra_px2) > 0.1:
        assert "25 standard errors" in sentence


def test_of_a_blur_without_detail_nothing_is_told() -> None:
    assert describe_focus(summary(extra_blur_err_px2=None)) is None


def test_a_q_value_far_below_one_in_a_million_is_not_spelt_out() -> None:
    assert q_text(3e-93) == "< 1e-06"
    assert q_text(0.0123) == "0.012"


def point(sighting: str, **values: float) -> TrackPoint:
    return TrackPoint.model_validate({"sighting": sighting, **values})


@pytest.mark.slow
def test_the_page_of_a_series_shows_the_time_line_and_links_each_follow_up() -> None:
    seen = point("seen", x_px=1, y_px=2, amplitude_dn=8, amplitude_err_dn=1, significance=8)
    lost = point("not seen", amplitude_dn=0.5, amplitude_err_dn=1, upper_limit_dn=2.1)
    track = ChangeTrack(
        reference_x_px=10,
        reference_y_px=20,
        first_seen=0,
        last_seen=2,
        points=(seen, lost, seen, point("not compared")),
    )
    names = ("a b", "c", "d", "e")
    line = ChangeTimeLine(
        reference="before.tif",
        order="time",
        followups=tuple(
            TimeLineFollowup(followup=f"{name}.tif", folder=name, changes=1) for name in names
        ),
        tracks=(track,),
    )
    series = ChangesSeries(
        reference="before.tif", compared=4, changed=2, refused=1, unpaired=("x.tif",)
    )
    rows = [
        *(ComparedFollowup(followup=f"{n}.tif", folder=n, zoom=1.0, changes=1) for n in names),
        ComparedFollowup(followup="f.tif", refused="f.tif: not an image"),
    ]
    reference = np.random.default_rng(0).normal(100, 10, SHAPE)
    document = series_report(series, rows, line, reference).html()
    read = Page(document)
    assert read.headings[:3] == ["Changes over several photographs", "Time line", "Follow-ups"]
    assert 'href="a%20b/report.html"' in document
    assert "not compared: f.tif: not an image" in read.texts
    assert "no partner: x.tif" in read.texts
    assert "3 of 4" not in read.text
    assert "2 of 4" in read.text
    pairs = Page(series_report(series, rows, None, None).html())
    assert "Time line" not in pairs.headings
    colours = coloured(reference, (1.0, 0.5, 0.1))
    for levels_dn, channels in ((reference, 2), (colours, 3)):
        drawn = plot_track_map(line, levels_dn).axes[0].images[0].get_array()
        assert drawn is not None
        assert drawn.ndim == channels


@pytest.mark.slow
def test_the_views_blink_and_move_together(tmp_path: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = Path("/usr/bin/chromium")
    if not chromium.exists():
        pytest.skip("no Chromium to look at the page with")
    path = tmp_path / "report.html"
    path.write_text(page()[0], encoding="utf-8")
    shown = """() => [...document.querySelectorAll(".view-large svg > use:not(.masks)")]
        .findIndex((layer) => layer.style.display === "")"""
    boxes = """() => JSON.stringify([...new Set(
        [...document.querySelectorAll("section.views svg")].map((v) => v.getAttribute("viewBox"))
    )].map((box) => box.split(" ").map(Number)))"""
    errors: list[str] = []
    with sync_api.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=str(chromium), args=["--no-sandbox", "--disable-gpu"]
        )
        view = browser.new_page()
        view.on("pageerror", lambda error: errors.append(str(error)))
        view.goto(path.as_uri())
        assert view.evaluate(shown) == 1
        view.keyboard.press(" ")
        assert view.evaluate(shown) == 0
        view.keyboard.press("d")
        assert view.evaluate(shown) == 2
        whole = json.loads(view.evaluate(boxes))
        assert whole == [[-0.5, -0.5, 80, 60]]
        view.click("table.changes tbody tr:nth-child(1)")
        (near,) = json.loads(view.evaluate(boxes))
        # All views show the change in their middle.
        assert near[2] < 40
        assert near[0] + near[2] / 2 == pytest.approx(20.0, abs=1e-6)
        assert near[1] + near[3] / 2 == pytest.approx(30.0, abs=1e-6)
        view.keyboard.press("0")
        assert json.loads(view.evaluate(boxes)) == whole
        view.keyboard.press("b")
        view.wait_for_function(f"({shown})() === 0")
        view.wait_for_function(f"({shown})() === 1")
        browser.close()
    assert errors == []


def test_what_moved_has_dashed_rings_and_rows_but_no_number() -> None:
    moved = CHANGES[0].model_copy(
        update={
            "is_moved": True,
            "displacement_px": (2.0, -1.0),
            "displacement_err_px": (0.1, 0.2),
            "x_px": 33.0,
        }
    )
    found = summary(moved=(moved,), moved_px=9)
    after = np.random.default_rng(0).normal(100, 10, SHAPE)
    pictures = compared_pictures(after, result(after), None)
    views = view_figures(pictures, CHANGES, (SHAPE[1], SHAPE[0]), found.moved)
    for view in views:
        assert view.markup.count("stroke-dasharray") == 1
        assert view.markup.count("<g data-change=") == len(CHANGES)
    assert "dashed green: moved" in views[1].caption
    page = Page(changes_report(found, views).html())
    assert "+2.0 ± 0.2" in page.text
    assert "-1.0 ± 0.4" in page.text
    assert "1 change is listed separately" in page.text.replace("\n", " ")
