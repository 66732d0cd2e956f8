"""Whether measured edges keep their limits, with the uncertainty of the measurement taken in.

A limit is passed where the whole 95 % interval keeps it, failed where none of it does, and unsure
where the interval straddles it (the decision rule of ISO 14253-1 with its zone of uncertainty).

Measured edges and verdicts as cells of tables, for the terminal and for reports. Every ± is half a
95 % interval.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, pi, sqrt
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, ValidationError, model_validator
from scipy.special import ndtri

from acquisition.files import StoredModel
from acquisition.written_files import WrittenTable, read_toml, validate_written, validation_lines
from calibration.edges import EdgeMeasurement
from calibration.errors import LimitsFileError
from calibration.estimate import NORMAL_95, Estimate, with_reach
from calibration.robust import robust_sigma
from calibration.sharpness._resolution import (
    lp_per_mm,
    lw_per_ph,
    picture_height_px,
    reported_mtf50,
)

Direction = Literal["meridional", "sagittal"]
Corner = Literal["top left", "top right", "bottom left", "bottom right"]

_NO_DIRECTION = 0.02
"""Share of the half diagonal within which an edge has no side of the axis: 10 px of 580 x 780."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _FieldPosition:
    """Position of an edge about the frame's centre, which is taken for the optical axis.

    ``radius`` is in half diagonals: 0 at the centre, 1 in the corners. ``direction`` is None at the
    centre. An edge is meridional where its normal is within 45 degrees of the radius: it tells the
    blur along the radius, as lines along the circumference do. The others are sagittal.
    """

    radius: float
    corner: Corner
    direction: Direction | None


def position_in_field(edge: EdgeMeasurement, width_px: int, height_px: int) -> _FieldPosition:
    """Return where an edge lies in a frame of this size."""
    right = edge.x_px - (width_px - 1) / 2
    down = edge.y_px - (height_px - 1) / 2
    radius = hypot(right, down) / (0.5 * hypot(width_px - 1, height_px - 1))
    corner: Corner
    if down < 0:
        corner = "top left" if right < 0 else "top right"
    else:
        corner = "bottom left" if right < 0 else "bottom right"
    direction: Direction | None = None
    if radius > _NO_DIRECTION:
        turn = edge.normal_rad - atan2(down, right)
        direction = "meridional" if abs(cos(turn)) >= cos(pi / 4) else "sagittal"
    return _FieldPosition(radius=radius, corner=corner, direction=direction)


_RISK = 0.05
_MEDIAN_ERR = sqrt(pi / 2)  # standard error of a median over that of a mean, Gaussian scatter
_FEWEST_FOR_SCATTER = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class _Figure(Estimate):
    """An estimate, and what or where it is of."""

    where: str = ""

    def modulus(self) -> "_Figure":
        """Return the figure without its sign."""
        low, high = sorted((abs(self.low), abs(self.high)))
        has_zero = self.low <= 0 <= self.high
        interval = (0.0 if has_zero else low, high)
        return replace(self, value=abs(self.value), interval_95=interval)


def _smallest(figures: Sequence[_Figure]) -> _Figure:
    """Return the smallest of several true values, with a simultaneous 95 % interval.

    Each of n figures gets the interval of 1 - 0.05 / n (Bonferroni): where all n hold, the smallest
    true value lies between the smallest of the lower and the smallest of the upper ends.
    """
    return _extreme("smallest", figures)


def _largest(figures: Sequence[_Figure]) -> _Figure:
    """Return the largest of several true values, with a simultaneous 95 % interval."""
    return _extreme("largest", figures)


def _extreme(which: Literal["smallest", "largest"], figures: Sequence[_Figure]) -> _Figure:
    if not figures:
        raise ValueError(f"the {which} of no figures")
    choose = min if which == "smallest" else max
    reach = _reach(len(figures))
    found = choose(figures, key=lambda figure: figure.value)
    return replace(
        found,
        interval_95=(
            choose(_least(figure, reach) for figure in figures),
            choose(figure.value + reach * figure.err for figure in figures),
        ),
    )


def _least(figure: _Figure, reach: float) -> float:
    """Lower end of an interval; what cannot be negative does not become so."""
    end = figure.value - reach * figure.err
    return max(end, 0.0) if figure.value >= 0 else end


def _median_of(figures: Sequence[_Figure], where: str) -> _Figure:
    """Return the median, with the larger of its scatter's error, from four on, and their own."""
    if not figures:
        raise ValueError("the median of no figures")
    values = np.array([figure.value for figure in figures])
    errs = np.array([figure.err for figure in figures])
    count = values.size
    share = 1.0 if count < 3 else _MEDIAN_ERR  # a median of two is their mean
    err = share * sqrt(float(np.mean(errs**2)) / count)
    middle = float(np.median(values))
    if count >= _FEWEST_FOR_SCATTER:
        err = max(err, _MEDIAN_ERR * robust_sigma(values - middle) / sqrt(count))
    return _Figure(value=middle, err=err, where=f"{where} ({count} edge{'s' * (count > 1)})")


def ratio(above: _Figure, below: _Figure) -> _Figure:
    """Return the ratio of two positive figures, with the extreme quotients as its interval.

    Each interval is widened to 97.5 % for that (Bonferroni).
    """
    widen = _reach(2) / _reach(1)
    low_above = max(above.value - widen * (above.value - above.low), 0.0)
    high_above = above.value + widen * (above.high - above.value)
    low_below = max(below.value - widen * (below.value - below.low), 1e-12)
    high_below = below.value + widen * (below.high - below.value)
    value = above.value / below.value
    return _Figure(
        value=value,
        err=value * sqrt((above.err / above.value) ** 2 + (below.err / below.value) ** 2),
        interval_95=(low_above / high_below, high_above / low_below),
        where=f"{above.where} over {below.where}",
    )


def _reach(count: int) -> float:
    """Half width in standard errors of intervals that hold all together in 95 % of cases."""
    return float(ndtri(1 - _RISK / (2 * count)))


Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, le=1)]


class Mtf50Limits(WrittenTable):
    """``[mtf50]``: least frequencies of half contrast."""

    min_cy_per_px: Positive | None = Field(None, description="every edge, in cycles per pixel")
    min_lw_per_ph: Positive | None = Field(
        None, description="every edge, in line widths per picture height"
    )
    min_lp_per_mm: Positive | None = Field(
        None, description="every edge, in line pairs per mm of the sensor"
    )
    centre_min_cy_per_px: Positive | None = Field(None, description="median of the central zone")
    centre_min_lw_per_ph: Positive | None = Field(None, description="likewise")
    centre_min_lp_per_mm: Positive | None = Field(None, description="likewise")
    corner_min_cy_per_px: Positive | None = Field(
        None, description="median of every corner, separately for meridional and sagittal"
    )
    corner_min_lw_per_ph: Positive | None = Field(None, description="likewise")
    corner_min_lp_per_mm: Positive | None = Field(None, description="likewise")


class SigmaLimits(WrittenTable):
    """``[sigma]``: largest widths of the PSF across every edge."""

    max_px: Positive | None = Field(None, description="total, of lens and pixel")
    optical_max_px: Positive | None = Field(None, description="of the lens alone")


class LateralColourLimits(WrittenTable):
    """``[lateral_colour]``: largest shift of red or blue from green across every edge."""

    max_px: Positive | None = Field(None, description="either way")


class UniformityLimits(WrittenTable):
    """``[uniformity]``: least ratios between parts of the field."""

    corner_to_centre_min: Share | None = Field(
        None, description="MTF50 of the softest corner over that of the central zone"
    )
    corner_to_corner_min: Share | None = Field(
        None, description="MTF50 of the softest corner over that of the sharpest: tilt, decentring"
    )


class SharpeningLimits(WrittenTable):
    """``[sharpening]``: of the median edge profile, over the contrast; for ``standoff lens``."""

    max_overshoot: Share | None = Field(None, description="beyond the bright level")
    max_undershoot: Share | None = Field(None, description="beyond the dark level")
    min_texture_over_edges: Share | None = Field(
        None, description="contrast that dead leaves keep, over that of the edges"
    )


class CameraLimits(WrittenTable):
    """``[camera]``: noise, and noise and sharpness together; for ``standoff lens``."""

    min_neq_at_half_nyquist: Positive | None = Field(
        None, description="noise-equivalent quanta a pixel at 0.25 cy/px, mean over directions"
    )
    min_information_bits_per_px: Positive | None = Field(
        None, description="capacity between the levels of the edges"
    )
    max_read_noise_e: Positive | None = Field(None, description="temporal dark noise")
    max_prnu: Share | None = Field(None, description="response pattern, over its mean")
    max_dsnu_e: Positive | None = Field(None, description="dark pattern")
    min_dynamic_range_db: Positive | None = Field(None, description="EMVA 1288")


class FocusLimits(WrittenTable):
    """``[focus]``: of photographs at several focus positions or heights; for ``standoff lens``."""

    max_tilt_mm: Positive | None = Field(
        None, description="change of the best focus over the picture, along its steepest line"
    )
    max_curvature_mm: Positive | None = Field(
        None, description="change of the best focus from the centre to the corners, either way"
    )
    max_astigmatism_mm: Positive | None = Field(
        None, description="tangential less sagittal focus in the corners, either way"
    )
    min_depth_mm: Positive | None = Field(
        None, description="depth over which an edge has the stated contrast, median"
    )
    min_common_depth_mm: Positive | None = Field(
        None, description="depth over which all edges have it at once"
    )


CAMERA_TABLES = ("sharpening", "camera", "focus")
"""Tables whose figures are those of ``standoff lens``, not of single edges."""


class Zones(WrittenTable):
    """``[zones]``: what is the centre and what a corner, in half diagonals from the centre."""

    centre_radius: Share = Field(0.3, description="radius of the central zone")
    corner_radius: Share = Field(0.7, description="radius at which the corners begin")

    @model_validator(mode="after")
    def _are_apart(self) -> Self:
        if not self.centre_radius <= self.corner_radius:
            raise ValueError(
                f"centre_radius {self.centre_radius:g} must not exceed corner_radius "
                f"{self.corner_radius:g}"
            )
        return self


class SharpnessLimits(WrittenTable):
    """A limits file: tables of limits, each of which may be left out."""

    mtf50: Mtf50Limits = Mtf50Limits.model_validate({})
    sigma: SigmaLimits = SigmaLimits.model_validate({})
    lateral_colour: LateralColourLimits = LateralColourLimits.model_validate({})
    uniformity: UniformityLimits = UniformityLimits.model_validate({})
    sharpening: SharpeningLimits = SharpeningLimits.model_validate({})
    camera: CameraLimits = CameraLimits.model_validate({})
    focus: FocusLimits = FocusLimits.model_validate({})
    zones: Zones = Zones.model_validate({})

    def given(self) -> Iterator[tuple[str, float]]:
        """Every limit that is set: its dotted key and its bound, in the order of the tables."""
        for table in ("mtf50", "sigma", "lateral_colour", "uniformity", *CAMERA_TABLES):
            for name, bound in getattr(self, table):
                if bound is not None:
                    yield f"{table}.{name}", bound


def read_limits(path: Path) -> SharpnessLimits:
    """Read a limits file."""
    source = str(path)
    try:
        limits = validate_written(SharpnessLimits, read_toml(path))
    except OSError as error:
        raise LimitsFileError(f"limits file {path}: {error.strerror}", source=source) from error
    except ValidationError as error:
        lines = validation_lines(error, SharpnessLimits)
        raise LimitsFileError(f"limits file {path}: {lines}", source=source) from error
    except ValueError as error:
        raise LimitsFileError(f"limits file {path}: {error}", source=source) from error
    if not any(limits.given()):
        raise LimitsFileError(
            f"limits file {path}: it sets no limit; set one, such as min_cy_per_px = 0.2 "
            "under [mtf50]",
            source=source,
        )
    return limits


Outcome = Literal["pass", "fail", "unsure"]


class LimitVerdict(StoredModel):
    """One limit: its key in the limits file, the figure measured, and the outcome.

    ``low`` and ``high`` are the ends of the figure's 95 % interval, ``where`` says which edge or
    part of the field it belongs to. A figure that could not be measured is null, and ``reason``
    says why.
    """

    limit: str
    bound: float
    unit: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    where: str = ""
    outcome: Outcome
    reason: str | None = None

    @property
    def is_least(self) -> bool:
        """Whether the limit is the least that is allowed, not the most."""
        return "min" in self.limit.partition(".")[2].split("_")


class SharpnessVerdict(StoredModel):
    """All limits of a file together: fail if one fails, else unsure if one is."""

    outcome: Outcome
    limits_file: str
    limits: tuple[LimitVerdict, ...]


def _outcome_of(low: float, high: float, bound: float, *, at_least: bool) -> Outcome:
    """Compare an interval with a limit: the least that is allowed, or the most."""
    if at_least:
        return "pass" if low >= bound else "fail" if high < bound else "unsure"
    return "pass" if high <= bound else "fail" if low > bound else "unsure"


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What the photographs share: size and pixel pitch; None where they differ or it is unknown."""

    width_px: int | None
    height_px: int | None
    pixel_pitch_um: float | None


class _NotMeasuredError(Exception):
    """Why a limit cannot be judged, and the remedy."""


def judge_sharpness(
    limits: SharpnessLimits,
    edges: Iterable[EdgeMeasurement],
    picture: Picture,
    limits_file: str,
    camera: Mapping[str, Estimate] | None = None,
) -> SharpnessVerdict:
    """Compare the edges that are used with the limits, in units that follow from the picture.

    ``camera`` are the figures of ``CAMERA_TABLES`` that were measured, by the keys of the limits.
    """
    used = [edge for edge in edges if edge.is_used]
    measured = _Measured(used, picture, limits.zones, camera or {})
    verdicts = tuple(_judged(key, bound, measured) for key, bound in limits.given())
    outcomes = {verdict.outcome for verdict in verdicts}
    outcome: Outcome = (
        "fail" if "fail" in outcomes else "unsure" if "unsure" in outcomes else "pass"
    )
    return SharpnessVerdict(outcome=outcome, limits_file=limits_file, limits=verdicts)


def _judged(key: str, bound: float, measured: "_Measured") -> LimitVerdict:
    table, name = key.split(".")
    unit = "px" if table in ("sigma", "lateral_colour") else _CAMERA_UNITS.get(name, "")
    if table == "mtf50":
        unit = _FREQUENCY_UNITS[name.rpartition("min_")[2]]
    limit = LimitVerdict(limit=key, bound=bound, unit=unit, outcome="unsure")
    try:
        figure = measured.figure(table, name, unit)
    except _NotMeasuredError as missing:
        return limit.model_copy(update={"reason": str(missing)})
    outcome = _outcome_of(figure.low, figure.high, bound, at_least=limit.is_least)
    known = {"value": figure.value, "low": figure.low, "high": figure.high, "where": figure.where}
    return limit.model_copy(update={**known, "outcome": outcome})


_CAMERA_UNITS = {
    "min_neq_at_half_nyquist": "quanta/px",
    "min_information_bits_per_px": "bits/px",
    "max_read_noise_e": "e",
    "max_dsnu_e": "e",
    "min_dynamic_range_db": "dB",
    "max_tilt_mm": "mm",
    "max_curvature_mm": "mm",
    "max_astigmatism_mm": "mm",
    "min_depth_mm": "mm",
    "min_common_depth_mm": "mm",
}
_THROUGH_FOCUS = "through focus: give photographs at five focus positions or more, and --focus-mm"
_FROM_FRAMES = "from darks and flats: give --dark and --flat"
_MEASURED_FROM = {
    "sharpening.max_overshoot": "on edges with an e-SFR",
    "sharpening.max_undershoot": "on edges with an e-SFR",
    "sharpening.min_texture_over_edges": "on dead leaves beside edges: give --leaves",
    "camera.min_neq_at_half_nyquist": "on linear photographs that show noise",
    "camera.min_information_bits_per_px": "on linear photographs that show noise",
    "camera.max_read_noise_e": _FROM_FRAMES,
    "camera.max_prnu": _FROM_FRAMES,
    "camera.max_dsnu_e": _FROM_FRAMES,
    "camera.min_dynamic_range_db": f"{_FROM_FRAMES}, one of them saturated",
}
_FREQUENCY_UNITS = {"cy_per_px": "cy/px", "lw_per_ph": "LW/PH", "lp_per_mm": "lp/mm"}


class _Measured:
    """The edges that count, and the figures that limits are compared with."""

    def __init__(
        self,
        used: Sequence[EdgeMeasurement],
        picture: Picture,
        zones: Zones,
        camera: Mapping[str, Estimate],
    ) -> None:
        self.used = used
        self.picture = picture
        self._zones = zones
        self._camera = camera

    def figure(self, table: str, name: str, unit: str) -> _Figure:
        """The figure that a limit of this table and name bounds."""
        if table in CAMERA_TABLES:
            return self._of_camera(f"{table}.{name}")
        if table == "mtf50":
            factor = self._factor(unit)
            return self._mtf50(name).scaled(factor)
        if table == "uniformity":
            corners = self._corners()
            is_to_centre = name == "corner_to_centre_min"
            return ratio(_smallest(corners), self._centre() if is_to_centre else _largest(corners))
        if table == "lateral_colour":
            return _largest(self._shifts())
        if name == "optical_max_px":
            return _largest(self._optical_widths())
        widths = ((e.sigma_px, e.sigma_err_px, _place(e)) for e in self.used)
        return _largest([_Figure(value=px, err=err, where=where) for px, err, where in widths])

    def _of_camera(self, key: str) -> _Figure:
        known = self._camera.get(key)
        if known is None:
            how = _MEASURED_FROM.get(key, _THROUGH_FOCUS)
            raise _NotMeasuredError(f"measured by standoff lens {how}")
        interval = known.interval_95
        return _Figure(value=known.value, err=known.err, interval_95=interval, where="camera")

    def _mtf50(self, name: str) -> _Figure:
        if name.startswith("centre_"):
            return self._centre()
        if name.startswith("corner_"):
            return _smallest(self._corners())
        return _smallest([_mtf50(edge) for edge in self.used])

    def _optical_widths(self) -> list[_Figure]:
        widths = [
            _Figure(value=e.optical_sigma_px, err=e.optical_sigma_err_px, where=_place(e))
            for e in self.used
            if e.optical_sigma_px is not None and e.optical_sigma_err_px is not None
        ]
        if not widths:
            raise _NotMeasuredError("every edge is as sharp as a pixel; set sigma.max_px instead")
        return widths

    def _shifts(self) -> list[_Figure]:
        shifts = [
            _Figure(value=shift, err=err, where=f"{colour}, {_place(edge)}").modulus()
            for edge in self.used
            for colour, shift, err in (
                ("red", edge.red_shift_px, edge.red_shift_err_px),
                ("blue", edge.blue_shift_px, edge.blue_shift_err_px),
            )
            if shift is not None and err is not None
        ]
        if not shifts:
            raise _NotMeasuredError("the photographs have no colours; give colour or raw files")
        return shifts

    def _factor(self, unit: str) -> float:
        """What a frequency in cy/px is multiplied by."""
        if unit == "LW/PH":
            return lw_per_ph(1.0, self._size()[1])
        if unit == "lp/mm":
            if self.picture.pixel_pitch_um is None:
                raise _NotMeasuredError("the pixel pitch is not known; give --pixel-pitch-um")
            return lp_per_mm(1.0, self.picture.pixel_pitch_um)
        return 1.0

    def _centre(self) -> _Figure:
        """Median MTF50 of the central zone."""
        radius = self._zones.centre_radius
        edges = [edge for edge, at in self._positions() if at.radius <= radius]
        if not edges:
            raise _NotMeasuredError(
                f"no edge within {radius:g} half diagonals of the centre; photograph one there, "
                "or set zones.centre_radius"
            )
        return _median_of([_mtf50(edge) for edge in edges], "centre")

    def _corners(self) -> list[_Figure]:
        """Median MTF50 of every corner, meridional and sagittal apart."""
        radius = self._zones.corner_radius
        groups: dict[str, list[_Figure]] = {}
        for edge, at in self._positions():
            if at.radius >= radius:
                name = f"{at.corner}, {at.direction}"
                groups.setdefault(name, []).append(_mtf50(edge))
        missing = set(get_args(Corner)) - {name.split(",")[0] for name in groups}
        if missing:
            raise _NotMeasuredError(
                f"no edge {radius:g} half diagonals or more from the centre, {_listed(missing)}; "
                "photograph one there, or set zones.corner_radius"
            )
        return [_median_of(figures, name) for name, figures in sorted(groups.items())]

    def _positions(self) -> list[tuple[EdgeMeasurement, _FieldPosition]]:
        width, height = self._size()
        return [(edge, position_in_field(edge, width, height)) for edge in self.used]

    def _size(self) -> tuple[int, int]:
        width, height = self.picture.width_px, self.picture.height_px
        if width is None or height is None:
            raise _NotMeasuredError("the photographs differ in size; calibrate those of one size")
        return width, height


def _listed(corners: set[str]) -> str:
    return "in any corner" if len(corners) == len(get_args(Corner)) else ", ".join(sorted(corners))


def _place(edge: EdgeMeasurement) -> str:
    return f"edge at ({edge.x_px:.0f}, {edge.y_px:.0f})"


def _mtf50(edge: EdgeMeasurement) -> _Figure:
    known = reported_mtf50(edge)
    return _Figure(value=known.cy_per_px, err=known.err_cy_per_px or 0.0, where=_place(edge))


def median_of_edges(edges: Sequence[EdgeMeasurement]) -> _Figure:
    """Return the median MTF50 of edges, in cy/px."""
    return _median_of([_mtf50(edge) for edge in edges], "all")


MODEL_REMARK = "* of the fitted Gaussian, where an edge has no e-SFR with an error"
_DIGITS = {"cy/px": 4, "LW/PH": 1, "lp/mm": 2, "px": 4, "": 4} | {
    "quanta/px": 0,
    "bits/px": 2,
    "e": 2,
    "dB": 2,
    "mm": 4,
}


Cells = tuple[str, ...]


def edge_cells(
    edges: Sequence[EdgeMeasurement], pixel_pitch_um: float | None, *, has_image: bool
) -> tuple[Cells, tuple[Cells, ...]]:
    """Return columns and rows of a table of edges: position, MTF50 in every unit, and widths.

    Without the pitch there are no line pairs per mm; with ``has_image`` a row begins with the name
    of the photograph.
    """
    columns = ["edge", "MTF50 / (cy/px)", "MTF50 / (LW/PH)"]
    columns += [] if pixel_pitch_um is None else ["MTF50 / (lp/mm)"]
    columns += ["sigma / px", "optical sigma / px"]
    return tuple(columns), tuple(_cells(edge, pixel_pitch_um, has_image) for edge in edges)


def _cells(edge: EdgeMeasurement, pixel_pitch_um: float | None, has_image: bool) -> Cells:
    known = reported_mtf50(edge)
    value, reach = known.cy_per_px, known.reach_95_cy_per_px
    factors = [(1.0, "cy/px"), (lw_per_ph(1.0, picture_height_px(edge) or 0.0), "LW/PH")]
    if pixel_pitch_um is not None:
        factors.append((lp_per_mm(1.0, pixel_pitch_um), "lp/mm"))
    cells = [
        with_reach(factor * value, None if reach is None else factor * reach, _DIGITS[unit])
        if factor
        else ""
        for factor, unit in factors
    ]
    cells[0] += "" if known.is_model_free else " *"
    optical, err = edge.optical_sigma_px, edge.optical_sigma_err_px
    return (
        edge_name(edge, has_image=has_image),
        *cells,
        Estimate(value=edge.sigma_px, err=edge.sigma_err_px).text(4),
        "not resolved"
        if optical is None
        else with_reach(optical, None if err is None else NORMAL_95 * err, 4),
    )


def edge_name(edge: EdgeMeasurement, *, has_image: bool) -> str:
    """Return a short name of an edge: its position, and its photograph where there are several."""
    place = f"({edge.x_px:.0f}, {edge.y_px:.0f}), {edge.angle_deg:.1f}°"
    return f"{PurePath(edge.image).name} {place}" if has_image else place


VERDICT_COLUMNS = ("limit", "allowed", "measured", "95 % interval", "verdict", "where, or why not")


def verdict_rows(verdict: SharpnessVerdict) -> tuple[Cells, ...]:
    """Return the limits as rows under ``VERDICT_COLUMNS``; a reason is written out once."""
    first_with: dict[str, str] = {}
    rows = []
    for one in verdict.limits:
        row = _limit_cells(one)
        if one.reason is not None:
            first = first_with.setdefault(one.reason, one.limit)
            row = row if first == one.limit else (*row[:-1], f"as for {first}")
        rows.append(row)
    return tuple(rows)


def _limit_cells(one: LimitVerdict) -> Cells:
    digits = _DIGITS[one.unit]
    allowed = f"{'at least' if one.is_least else 'at most'} {one.bound:g} {one.unit}".rstrip()
    if one.value is None or one.low is None or one.high is None:
        return (one.limit, allowed, "not measured", "", one.outcome, one.reason or "")
    return (
        one.limit,
        allowed,
        f"{one.value:.{digits}f}",
        f"{one.low:.{digits}f} to {one.high:.{digits}f}",
        one.outcome,
        one.where,
    )


_MTF50 = ("mtf50_cy_per_px", "mtf50_err_cy_per_px", "mtf50_lw_per_ph", "mtf50_lp_per_mm")


def edge_row(edge: EdgeMeasurement) -> dict[str, Any]:
    """Return an edge as a line of a table: the entries of psf.json, with MTF50 as it is reported.

    In psf.json ``mtf50_...`` is the fitted Gaussian's. Here it is that of ``reported_mtf50``,
    measured where the edge determines it; ``mtf50_from`` says whether it is of the ``e-SFR`` or of
    the ``gaussian``, whose own stands in ``gaussian_mtf50_...``.
    """
    stored = edge.model_dump()
    is_measured = reported_mtf50(edge).is_model_free
    row: dict[str, Any] = {}
    for name, value in stored.items():
        row[name] = stored[f"esfr_{name}"] if is_measured and name in _MTF50 else value
    row["mtf50_from"] = "e-SFR" if is_measured else "gaussian"
    row |= {f"gaussian_{name}": stored[name] for name in _MTF50}
    return row
