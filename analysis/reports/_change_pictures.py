"""The pictures and views of a comparison, all on the follow-up's pixels, as a screen shows them."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import cv2
import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, ScalarFormatter
from numpy.typing import NDArray

from acquisition.photographs import on_screen, white_level_dn
from analysis.changes import Change, ChangeResult
from analysis.detection_limits import size_text
from analysis.reports._page import ReportFigure, new_figure
from calibration.registration import DistortedPose
from simulation.arrays import AnyArray, BoolArray, FloatArray, FloatImage
from simulation.palette import BLUE, GREEN, VERMILION

Bytes = NDArray[np.uint8]

LONGEST_SIDE_PX = 1600
"""Of a picture in the page; larger photographs are averaged down. 12 MP would be 9 MB a page."""

_DIVERGING = "RdBu_r"
_NOT_COMPARED, CLIPPED, _LEFT_OUT = "#6b7280", "#e69f00", "#8e44ad"

_DISPLAY_GAMMA = 2.2
_ENDS_PERCENT = (0.2, 99.8)
_REACH_PERCENT = 99.5
_HATCH_PX = 12
_FAINT = 4.0
"""Standard deviations of a typical pixel at full colour, at least."""

_JPEG_QUALITY = 92
_BOX_SIGMA = 12**-0.5
"""Standard deviation of a box of unit width."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ColourPair:
    """Reference and follow-up in colour: shape ``(rows, cols, 3)`` each, linear in light."""

    reference_dn: AnyArray
    followup_dn: AnyArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _ComparedPictures:
    """Pictures of one size, which may be smaller than the follow-up, as bytes of files.

    ``before, after, difference``: JPEG: the reference brought onto the follow-up's pixels and into
    its light, the follow-up, and what is left of their difference. ``masks``: PNG with opacity:
    pixels that were not compared, by reason. ``reach_dn``: difference at the ends of the colour
    scale. ``is_colour``: whether the photographs are shown in colour.
    """

    before: bytes
    after: bytes
    difference: bytes
    masks: bytes
    reach_dn: float
    is_colour: bool = False


def compared_pictures(
    reference_dn: FloatArray,
    found: ChangeResult,
    left_out: BoolArray | None,
    colours: ColourPair | None = None,
) -> _ComparedPictures:
    """Draw the pictures of a comparison.

    Grey levels are stretched between their ends, and those of the reference get the follow-up's
    mean and contrast. Colours are only made brighter or darker, by one factor for all channels,
    which leaves hues as they are: the follow-up's by what makes its brightest pixels white, the
    reference's by what gives it the follow-up's mean level. ``reference_dn``: the reference in
    grey, shape ``(rows, cols)``. ``left_out``: follow-up pixels that the operator left out, if any.
    ``colours``: both photographs in colour; None if one of them is grey.
    """
    before, after = (
        _grey_pictures(reference_dn, found) if colours is None else _colour_pictures(colours, found)
    )
    reach_dn = _reach_dn(found)
    difference_dn = _smaller(np.where(found.valid, found.difference_dn, np.float32(0)))
    return _ComparedPictures(
        before=before,
        after=after,
        difference=_jpeg(_coloured(0.5 + difference_dn / (2 * reach_dn))),
        masks=_png(_masks(found, left_out)),
        reach_dn=reach_dn,
        is_colour=colours is not None,
    )


def _grey_pictures(reference_dn: FloatArray, found: ChangeResult) -> tuple[bytes, bytes]:
    """Before and after."""
    after_dn, valid = _smaller(found.followup_dn), _fewer(found.valid)
    before_dn = _in_light_of(after_dn, _on_followup(reference_dn, found.pose), valid)
    low, high = _display_ends(after_dn, valid)
    return _jpeg(_displayed(before_dn, low, high)), _jpeg(_displayed(after_dn, low, high))


def _colour_pictures(colours: ColourPair, found: ChangeResult) -> tuple[bytes, bytes]:
    """Before and after."""
    after_dn = _smaller(np.asarray(colours.followup_dn, dtype=np.float32))
    before_dn = _on_followup(colours.reference_dn, found.pose)
    used = _fewer(found.valid) & np.isfinite(before_dn).all(axis=2)
    white_dn = white_level_dn(after_dn[used] if used.any() else after_dn)
    mean_before, mean_after = (
        float(one[used].mean()) if used.any() else 0.0 for one in (before_dn, after_dn)
    )
    gain = mean_after / mean_before if mean_before > 0 and mean_after > 0 else 1.0
    return _colour_jpeg(gain * before_dn, white_dn), _colour_jpeg(after_dn, white_dn)


def _on_followup(reference_dn: AnyArray, pose: DistortedPose) -> FloatImage:
    """The reference, grey or in colour, on the picture's pixels; NaN beyond its border."""
    rows, cols = pose.followup_shape
    step = _step((rows, cols))
    y, x = (np.arange(-(-side // step)) * step + (step - 1) / 2 for side in (rows, cols))
    places_y, places_x = pose.to_reference_px(*np.meshgrid(y, x, indexing="ij"))
    softened = np.asarray(reference_dn, dtype=np.float32)
    covered_px = step * pose.zoom
    if covered_px > 1:
        # What a pixel of the picture covers; symmetric, unlike a box of an even side.
        sigma_px = _BOX_SIGMA * np.sqrt(covered_px**2 - 1)
        softened = np.asarray(cv2.GaussianBlur(softened, (0, 0), sigma_px), dtype=np.float32)
    seen = cv2.remap(
        softened,
        places_x.astype(np.float32),
        places_y.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    is_inside = (
        np.abs(places_y - (reference_dn.shape[0] - 1) / 2) <= reference_dn.shape[0] / 2
    ) & (np.abs(places_x - (reference_dn.shape[1] - 1) / 2) <= reference_dn.shape[1] / 2)
    if seen.ndim == 3:
        is_inside = is_inside[:, :, np.newaxis]
    return np.asarray(np.where(is_inside, seen, np.nan))


def _in_light_of(after_dn: FloatImage, before_dn: FloatImage, valid: BoolArray) -> FloatImage:
    """The earlier photograph with the mean and contrast of the later one, so that none flickers."""
    used = valid & np.isfinite(before_dn)
    if np.count_nonzero(used) < 2:
        return before_dn
    before, after = before_dn[used], after_dn[used]
    spread = float(before.std())
    if not spread > 0:
        return before_dn
    gain = float(np.mean((before - before.mean()) * (after - after.mean()))) / spread**2
    if not gain > 0:
        return before_dn
    return np.asarray(after.mean() + gain * (before_dn - before.mean()))


def _display_ends(image_dn: FloatImage, valid: BoolArray) -> tuple[float, float]:
    low, high = np.percentile(image_dn[valid] if valid.any() else image_dn, _ENDS_PERCENT)
    return float(low), float(max(high, low + 1e-9))


def _reach_dn(found: ChangeResult) -> float:
    """Difference of full colour: the largest ones, if noise then looks faint."""
    if not found.valid.any():
        return 1.0
    beyond = float(np.percentile(np.abs(found.difference_dn[found.valid]), _REACH_PERCENT))
    noise_dn = float(np.sqrt(np.median(found.variance_dn2[found.valid])))
    return max(beyond, _FAINT * noise_dn, 1e-9)


def _displayed(image_dn: FloatImage, low: float, high: float) -> Bytes:
    share = np.clip((image_dn - low) / (high - low), 0.0, 1.0)
    share = np.nan_to_num(share ** (1 / _DISPLAY_GAMMA), nan=0.5)
    return np.asarray(np.rint(255 * share), dtype=np.uint8)


def _coloured(shade: FloatImage) -> Bytes:
    rgb = np.asarray(mpl.colormaps[_DIVERGING](np.clip(shade, 0.0, 1.0), bytes=True))[..., :3]
    return np.ascontiguousarray(rgb[..., ::-1], dtype=np.uint8)  # OpenCV's order


def _masks(found: ChangeResult, left_out: BoolArray | None) -> Bytes:
    """Colours with opacity: hatched where nothing was compared, full where the reason is known."""
    rows, cols = found.valid.shape
    across = np.add.outer(np.arange(rows), np.arange(cols)) % _HATCH_PX < _HATCH_PX / 3
    picture = np.zeros((rows, cols, 4), dtype=np.uint8)
    picture[~found.valid] = _rgba(_NOT_COMPARED, 50)
    picture[~found.valid & across] = _rgba(_NOT_COMPARED, 150)
    picture[found.masks.clipped | found.masks.reference_clipped] = _rgba(CLIPPED, 190)
    if left_out is not None:
        picture[left_out] = _rgba(_LEFT_OUT, 120)
        picture[left_out & across] = _rgba(_LEFT_OUT, 200)
    step = _step(picture.shape)
    return np.ascontiguousarray(picture[::step, ::step][..., [2, 1, 0, 3]])


def _rgba(colour: str, opacity: int) -> tuple[int, int, int, int]:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue, opacity


def _smaller(image: FloatImage) -> FloatImage:
    step = _step(image.shape)
    if step == 1:
        return image
    rows, cols = image.shape[:2]
    size = (-(-cols // step), -(-rows // step))
    return np.asarray(
        cv2.resize(np.asarray(image, dtype=np.float32), size, interpolation=cv2.INTER_AREA),
        dtype=np.float64,
    )


def _fewer(mask: BoolArray) -> BoolArray:
    """A mask on the picture's pixels."""
    step = _step(mask.shape)
    return mask[::step, ::step]


def _step(shape: tuple[int, ...]) -> int:
    return -(-max(shape[:2]) // LONGEST_SIDE_PX)


def _jpeg(picture: Bytes) -> bytes:
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _colour_jpeg(colours_dn: FloatImage, white_dn: float) -> bytes:
    share = np.nan_to_num(on_screen(colours_dn, white_dn), nan=0.5)
    shown = np.rint(255 * share[..., ::-1]).astype(np.uint8)  # OpenCV's order
    # Colours of every pixel: JPEG halves their resolution otherwise, and with it small changes.
    sampling = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY, *sampling]
    return cv2.imencode(".jpg", np.ascontiguousarray(shown), options)[1].tobytes()


def _png(picture: Bytes) -> bytes:
    return cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


_DRAWN_PX = 900
_LIMIT_ENDS_PERCENT = (0.5, 99.5)
_LEAST_RATIO = 1.5
"""Of the ends of the scale: noise alone makes the limit vary by a few per cent."""


def limit_figure(found: ChangeResult) -> ReportFigure | None:
    """Draw the detection limit over the follow-up; None if nothing was compared."""
    limit = found.summary.detection_limit
    if limit is None or not found.valid.any():
        return None
    low, high = np.percentile(found.limit_dn[found.valid], _LIMIT_ENDS_PERCENT)
    middle, ratio = np.sqrt(low * high), max(np.sqrt(high / low), _LEAST_RATIO**0.5)
    norm = LogNorm(middle / ratio, middle * ratio)
    figure, bar = _map_figure(found.limit_dn, norm, "limit / DN")
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
    bar.ax.yaxis.set_major_formatter(ScalarFormatter())
    bar.ax.yaxis.set_minor_locator(LogLocator(subs=()))
    caption = (
        f"Amplitude at which a spot of {size_text(limit.mapped, limit)} is found "
        f"{100 * limit.power:.0f} times out of 100. Grey: not compared."
    )
    return ReportFigure.of(figure, caption, form="png")


def _map_figure(image: FloatImage, norm: Normalize, label: str) -> tuple[Figure, Colorbar]:
    """Draw a map over the follow-up, grey where it is NaN."""
    rows, cols = image.shape
    step = -(-max(rows, cols) // _DRAWN_PX)
    width_in = 6.0
    figure = new_figure(width_in, 0.3 + (width_in - 1.0) * rows / cols)
    axes = figure.subplots()
    axes.set_facecolor(_NOT_COMPARED)
    drawn = axes.imshow(
        np.ma.masked_invalid(image[::step, ::step]),
        cmap="cividis",
        norm=norm,
        extent=(-0.5, cols - 0.5, rows - 0.5, -0.5),
        interpolation="nearest",
    )
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    return figure, figure.colorbar(drawn, ax=axes, label=label, shrink=0.9)


def depth_figure(found: ChangeResult, height_mm: FloatImage | None = None) -> ReportFigure | None:
    """Draw the parallax over the follow-up, or the heights; None where a plane explains the pair.

    ``height_mm``: on the follow-up's pixels, shape ``(rows, cols)``, if they are known.
    """
    figures = found.summary.parallax
    if found.parallax is None or figures is None:
        return None
    shown, label = found.parallax.parallax_px, "parallax / px"
    low, high = figures.low_px, figures.high_px
    what = "Displacement beside the plane of the pose, towards the epipole"
    if figures.larger_is is not None:
        what += f": the larger, the {figures.larger_is}"
    if height_mm is not None and figures.heights is not None:
        shown, label = height_mm, "height / mm"
        low, high = figures.heights.low_mm, figures.heights.high_mm
        what = "Height above the plane of the pose, towards the camera"
    figure, _ = _map_figure(shown, Normalize(low, high), label)
    caption = (
        f"{what}. Grey: not compared, as it is beyond the reference, hidden in one of the two, "
        "beside a step, or of unknown depth."
    )
    return ReportFigure.of(figure, caption, form="png")


_BRIGHTER, _DARKER, MOVED = VERMILION.lower(), BLUE.lower(), GREEN.lower()

_PRINTED_WIDTH_IN = 2.38  # three side by side on A4
_RING_SHARE = 1 / 70  # of the frame's width: the least radius of a ring that is seen
_TEXT_SHARE = 1 / 36
_MOST_MARKED = 200


def view_figures(
    pictures: _ComparedPictures,
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
    shown = {"before": pictures.before, "after": pictures.after, "difference": pictures.difference}
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
    colour = _BRIGHTER if change.amplitude_dn > 0 else _DARKER
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
