"""Whether measured edges keep their limits, with the uncertainty of the measurement taken in.

A limit is passed where the whole 95 % interval keeps it, failed where none of it does, and unsure
where the interval straddles it (the decision rule of ISO 14253-1 with its zone of uncertainty).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict

from calibration.edges import EdgeMeasurement
from calibration.sharpness.field_position import Corner, FieldPosition, position_in_field
from calibration.sharpness.intervals import Figure, largest, median_of, ratio, smallest
from calibration.sharpness.limits import SharpnessLimits, Zones
from calibration.sharpness.resolution import lp_per_mm, lw_per_ph, reported_mtf50

Outcome = Literal["pass", "fail", "unsure"]


class LimitVerdict(BaseModel):
    """One limit: its key in the limits file, the figure measured, and the outcome.

    ``low`` and ``high`` are the ends of the figure's 95 % interval, ``where`` says which edge or
    part of the field it belongs to. A figure that could not be measured is null, and ``reason``
    says why.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

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
        return is_least(self.limit)


class SharpnessVerdict(BaseModel):
    """All limits of a file together: fail if one fails, else unsure if one is."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    outcome: Outcome
    limits_file: str
    limits: tuple[LimitVerdict, ...]


def is_least(key: str) -> bool:
    """Whether a limit of this key is the least that is allowed, not the most."""
    return "min" in key.partition(".")[2].split("_")


def outcome_of(low: float, high: float, bound: float, *, at_least: bool) -> Outcome:
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
) -> SharpnessVerdict:
    """Compare the edges that are used with the limits.

    Parameters
    ----------
    limits
        Where to judge what.
    edges
        Of all photographs; rejected ones do not count.
    picture
        Units and positions follow from it.
    limits_file
        Name of the file, for the document.
    """
    used = [edge for edge in edges if edge.is_used]
    verdicts = tuple(
        _judged(key, bound, _Measured(used, picture, limits.zones)) for key, bound in limits.given()
    )
    outcomes = {verdict.outcome for verdict in verdicts}
    outcome: Outcome = (
        "fail" if "fail" in outcomes else "unsure" if "unsure" in outcomes else "pass"
    )
    return SharpnessVerdict(outcome=outcome, limits_file=limits_file, limits=verdicts)


def _judged(key: str, bound: float, measured: "_Measured") -> LimitVerdict:
    table, name = key.split(".")
    figure_of, unit = _FIGURES[table](name)
    try:
        figure = figure_of(measured)
    except _NotMeasuredError as missing:
        return LimitVerdict(
            limit=key, bound=bound, unit=unit, outcome="unsure", reason=str(missing)
        )
    return LimitVerdict(
        limit=key,
        bound=bound,
        unit=unit,
        value=figure.value,
        low=figure.low,
        high=figure.high,
        where=figure.where,
        outcome=outcome_of(figure.low, figure.high, bound, at_least=is_least(key)),
    )


class _Measured:
    """The edges that count, and the figures that limits are compared with."""

    def __init__(self, used: Sequence[EdgeMeasurement], picture: Picture, zones: Zones) -> None:
        self.used = used
        self.picture = picture
        self._zones = zones

    def factor(self, unit: str) -> float:
        """What a frequency in cy/px is multiplied by."""
        if unit == "LW/PH":
            return lw_per_ph(1.0, self._size()[1])
        if unit == "lp/mm":
            if self.picture.pixel_pitch_um is None:
                raise _NotMeasuredError("the pixel pitch is not known; give --pixel-pitch-um")
            return lp_per_mm(1.0, self.picture.pixel_pitch_um)
        return 1.0

    def every_edge(self) -> Figure:
        """MTF50 of the softest edge."""
        return smallest([_mtf50(edge) for edge in self.used])

    def centre(self) -> Figure:
        """Median MTF50 of the central zone."""
        radius = self._zones.centre_radius
        edges = [edge for edge, at in self._positions() if at.radius <= radius]
        if not edges:
            raise _NotMeasuredError(
                f"no edge within {radius:g} half diagonals of the centre; photograph one there, "
                "or set zones.centre_radius"
            )
        return median_of([_mtf50(edge) for edge in edges], "centre")

    def corners(self) -> list[Figure]:
        """Median MTF50 of every corner, meridional and sagittal apart."""
        radius = self._zones.corner_radius
        groups: dict[str, list[Figure]] = {}
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
        return [median_of(figures, name) for name, figures in sorted(groups.items())]

    def _positions(self) -> list[tuple[EdgeMeasurement, FieldPosition]]:
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


def _mtf50(edge: EdgeMeasurement) -> Figure:
    known = reported_mtf50(edge)
    return Figure.normal(known.cy_per_px, known.err_cy_per_px or 0.0, _place(edge))


def median_of_edges(edges: Sequence[EdgeMeasurement]) -> Figure:
    """Return the median MTF50 of edges, in cy/px.

    Raises
    ------
    ValueError
        If there is none.
    """
    return median_of([_mtf50(edge) for edge in edges], "all")


_FigureOf = Callable[[_Measured], Figure]


def _mtf50_limit(name: str) -> tuple[_FigureOf, str]:
    zone, _, unit_name = name.rpartition("min_")
    unit = {"cy_per_px": "cy/px", "lw_per_ph": "LW/PH", "lp_per_mm": "lp/mm"}[unit_name]

    def figure(measured: _Measured) -> Figure:
        factor = measured.factor(unit)
        if zone == "centre_":
            found = measured.centre()
        elif zone == "corner_":
            found = smallest(measured.corners())
        else:
            found = measured.every_edge()
        return found.scaled(factor)

    return figure, unit


def _sigma_limit(name: str) -> tuple[_FigureOf, str]:
    def total(measured: _Measured) -> Figure:
        return largest(
            [Figure.normal(e.sigma_px, e.sigma_err_px, _place(e)) for e in measured.used]
        )

    def optical(measured: _Measured) -> Figure:
        known = [
            Figure.normal(e.optical_sigma_px, e.optical_sigma_err_px, _place(e))
            for e in measured.used
            if e.optical_sigma_px is not None and e.optical_sigma_err_px is not None
        ]
        if not known:
            raise _NotMeasuredError("every edge is as sharp as the pixel alone; limit sigma.max_px")
        return largest(known)

    return (optical if name == "optical_max_px" else total), "px"


def _lateral_colour_limit(_: str) -> tuple[_FigureOf, str]:
    def figure(measured: _Measured) -> Figure:
        shifts = [
            Figure.normal(shift, err, f"{colour}, {_place(edge)}").modulus()
            for edge in measured.used
            for colour, shift, err in (
                ("red", edge.red_shift_px, edge.red_shift_err_px),
                ("blue", edge.blue_shift_px, edge.blue_shift_err_px),
            )
            if shift is not None and err is not None
        ]
        if not shifts:
            raise _NotMeasuredError("the photographs have no colours; give colour or raw files")
        return largest(shifts)

    return figure, "px"


def _uniformity_limit(name: str) -> tuple[_FigureOf, str]:
    def figure(measured: _Measured) -> Figure:
        corners = measured.corners()
        softest = smallest(corners)
        if name == "corner_to_centre_min":
            return ratio(softest, measured.centre())
        return ratio(softest, largest(corners))

    return figure, ""


_FIGURES: dict[str, Callable[[str], tuple[_FigureOf, str]]] = {
    "mtf50": _mtf50_limit,
    "sigma": _sigma_limit,
    "lateral_colour": _lateral_colour_limit,
    "uniformity": _uniformity_limit,
}
