"""The views of a comparison as SVG: pictures, masks and numbered changes in one frame."""

from base64 import b64encode
from collections.abc import Sequence
from math import pi, sqrt

from markupsafe import Markup

from analysis.changes import Change
from analysis.reports.changes.pictures import ComparedPictures
from analysis.reports.page import ReportFigure

BRIGHTER, DARKER, MOVED = "#d55e00", "#0072b2", "#009e73"

_PRINTED_WIDTH_IN = 2.38  # three side by side on A4
_RING_SHARE = 1 / 70  # of the frame's width: the least radius of a ring that is seen
_TEXT_SHARE = 1 / 36
_MOST_MARKED = 200


def view_figures(
    pictures: ComparedPictures,
    changes: Sequence[Change],
    size: tuple[int, int],
    moved: Sequence[Change] = (),
) -> tuple[ReportFigure, ...]:
    """Return the views before, after and difference; the page's script links and blinks them.

    ``changes``: numbered from 1 in this order. ``size``: ``(width, height)`` of the follow-up, in
    whose pixels changes are placed. ``moved``: movements, which get dashed rings without numbers.
    """
    marks = "".join(_moved_mark(change, size[0]) for change in moved[:_MOST_MARKED])
    marks += "".join(
        _mark(number, change, size[0]) for number, change in enumerate(changes[:_MOST_MARKED], 1)
    )
    light = (
        "as bright as the follow-up; its hues are its own"
        if pictures.is_colour
        else "in the follow-up's light"
    )
    captions = {
        "before": f"Before: the reference on the follow-up's pixels, {light}.",
        "after": "After: the follow-up. Rings and numbers are the changes of the list: "
        "orange brighter, blue darker than before" + ("; dashed green: moved." if moved else "."),
        "difference": "After minus before, less what pose, light and blur explain: red is "
        f"brighter, blue darker, full colour at {pictures.reach_dn:.3g} DN.",
    }
    shown = {
        "before": pictures.before,
        "after": pictures.after,
        "difference": pictures.difference,
    }
    return tuple(
        ReportFigure(
            markup=_view(name, picture, pictures.masks, marks, size),
            caption=captions[name],
            width_in=_PRINTED_WIDTH_IN,
        )
        for name, picture in shown.items()
    )


def _view(name: str, picture: bytes, masks: bytes, marks: str, size: tuple[int, int]) -> Markup:
    width, height = size
    frame = f'x="-0.5" y="-0.5" width="{width}" height="{height}" preserveAspectRatio="none"'
    return Markup(  # noqa: S704 - numbers and base64 of our own
        f'<svg data-view="{name}" viewBox="-0.5 -0.5 {width} {height}" role="img" '
        f'aria-label="{name}" xmlns="http://www.w3.org/2000/svg">'
        f'<image class="picture" {frame} href="{_url(picture, "jpeg")}"/>'
        f'<image class="masks" {frame} href="{_url(masks, "png")}"/>'
        f'<g class="marks">{marks}</g></svg>'
    )


def _moved_mark(change: Change, width: int) -> str:
    return (
        f"<circle {_ring(change, _radius_px(change, width))} "
        f'stroke="{MOVED}" stroke-width="{width / 350:.2f}" stroke-dasharray="{width / 90:.2f}"/>'
    )


def _mark(number: int, change: Change, width: int) -> str:
    radius = _radius_px(change, width)
    text_px = width * _TEXT_SHARE
    colour = BRIGHTER if change.amplitude_dn > 0 else DARKER
    # Above the ring, or below it where the frame ends.
    rise = radius + 0.25 * text_px
    text_y = change.y_px + (-rise if change.y_px > 2 * rise else rise + 0.7 * text_px)
    ring = _ring(change, radius)
    letters = (
        f'x="{change.x_px:.2f}" y="{text_y:.2f}" text-anchor="middle" '
        f'font-size="{text_px:.2f}" font-family="sans-serif" font-weight="bold"'
    )
    return (
        f'<g data-change="{number}" data-x="{change.x_px:.3f}" data-y="{change.y_px:.3f}" '
        f'data-radius="{radius:.2f}">'
        f'<circle {ring} stroke="#fff" stroke-width="{width / 200:.2f}" stroke-opacity="0.7"/>'
        f'<circle {ring} stroke="{colour}" stroke-width="{width / 350:.2f}"/>'
        f'<text {letters} fill="#fff" stroke="#fff" stroke-width="{text_px / 6:.2f}">{number}'
        f'</text><text {letters} fill="{colour}">{number}</text></g>'
    )


def _url(picture: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{b64encode(picture).decode('ascii')}"


def _radius_px(change: Change, width: int) -> float:
    """Radius of a ring around a change, in a frame of this width."""
    return max(1.7 * sqrt(change.area_px / pi), width * _RING_SHARE)


def _ring(change: Change, radius_px: float) -> str:
    """Attributes of a circle around a change."""
    return f'cx="{change.x_px:.2f}" cy="{change.y_px:.2f}" r="{radius_px:.2f}" fill="none"'
