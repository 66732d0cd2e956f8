"""What it takes to know a quantity as well as is wanted, and the cheapest way to it.

Each source of an error shrinks with the root of the number of something: frames, edges, runs of the
plan, photographs of the scene. How many of one alone, or of several together, follows in closed
form.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Literal

from analysis.study.document import Quantity, StudiedWant, StudyNeeds
from analysis.study.sources import LEVERS, Lever, Prediction

WantName = Literal["sigma", "transfer", "pupil", "dprime", "tilt"]

QUANTITIES: dict[WantName, tuple[Quantity, ...]] = {
    "sigma": ("sigma_x_px", "sigma_y_px"),
    "transfer": ("transfer_x", "transfer_y"),
    "pupil": ("pupil_offset_mm",),
    "dprime": ("d_prime",),
    "tilt": ("tilt_limit_deg",),
}
"""What a want is about; of two, both are wanted."""

UNITS: dict[WantName, str] = {
    "sigma": "%",
    "transfer": "%",
    "pupil": "mm",
    "dprime": "%",
    "tilt": "deg",
}

SPOKEN: dict[WantName, str] = {
    "sigma": "sigma",
    "transfer": "the transfer at half Nyquist",
    "pupil": "the pupil offset",
    "dprime": "d' at zoom 1.5",
    "tilt": "the tilt limit",
}

_MOST: dict[Lever, int] = {"frames": 1000, "edges": 100_000, "runs": 1000, "photographs": 100_000}
_HARDLY = 0.05  # of the variance
_PHOTOGRAPH_S = 60.0
_SLACK = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Want:
    """A wanted 95 % half-width, relative where the unit is %."""

    name: WantName
    half_width: float

    def __post_init__(self) -> None:
        if not 0 < self.half_width < float("inf"):
            raise ValueError(f"what is wanted must be above 0, got {self.half_width:g}")

    @property
    def is_relative(self) -> bool:
        """Whether it is a share of the value."""
        return UNITS[self.name] == "%"

    def text(self, half_width: float) -> str:
        """A half-width in the want's unit, such as ``0.5 %``."""
        if self.is_relative:
            return f"{100 * half_width:.2g} %"
        return f"{half_width:.2g} {'degrees' if self.name == 'tilt' else UNITS[self.name]}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSize:
    """How much of everything a plan has, and what more of it costs.

    ``run_s`` is the time of the whole plan, ``frame_s`` that of one frame more in every capture.
    """

    frames: int
    edges: int
    photographs: int
    run_s: float
    frame_s: float

    def now(self, lever: Lever) -> int:
        """Present number."""
        known: dict[Lever, int] = {
            "frames": self.frames,
            "edges": self.edges,
            "runs": 1,
            "photographs": self.photographs,
        }
        return known[lever]

    def seconds(self, lever: Lever, wanted: int) -> float:
        """Time for as many as are wanted; infinite for edges, which need another target."""
        more = wanted - self.now(lever)
        rates = {"frames": self.frame_s, "runs": self.run_s, "photographs": _PHOTOGRAPH_S}
        return more * rates.get(lever, float("inf"))


def studied_want(want: Want, predictions: Sequence[Prediction], size: PlanSize) -> StudiedWant:
    """Say whether a want is met, and what it takes where it is not.

    ``predictions``: all predictions; those of the want's quantities count, the worst of them.
    """
    asked = [one for one in predictions if one.quantity in QUANTITIES[want.name]]
    missing = next((one for one in asked if not _is_known(one, want)), None)
    if missing is not None:
        why = missing.undetermined or "nothing is known of its value"
        return StudiedWant(
            quantity=want.name,
            wanted=want.half_width,
            is_relative=want.is_relative,
            predicted=None,
            reached=False,
            needs=StudyNeeds(),
            sentence=f"Nothing can be said of {SPOKEN[want.name]}: {why}.",
        )
    worst = max(asked, key=lambda one: one.half_width_95 / _scale(one, want))
    predicted = worst.half_width_95 / _scale(worst, want)
    reached = predicted <= want.half_width * (1 + _SLACK)
    needs = StudyNeeds() if reached else _needs(want, worst, size)
    return StudiedWant(
        quantity=want.name,
        wanted=want.half_width,
        is_relative=want.is_relative,
        predicted=predicted,
        reached=reached,
        needs=needs,
        sentence=_sentence(want, worst, needs, size, reached=reached),
    )


def next_step(
    wants: Sequence[StudiedWant], predictions: Sequence[Prediction], size: PlanSize
) -> str:
    """Return one sentence: what to do next.

    The want that is furthest from being met comes first; without any, what a doubling brings where
    most of the error of d', or of sigma, comes from.
    """
    open_ = [one for one in wants if not one.reached]
    if open_:
        return max(open_, key=lambda one: (one.predicted or float("inf")) / one.wanted).sentence
    if wants:
        return "Run the plan: it gives all that is wanted."
    for name in ("dprime", "sigma", "pupil"):
        asked = [one for one in predictions if one.quantity in QUANTITIES[name]]
        probe = Want(name=name, half_width=1.0)
        known = [one for one in asked if _is_known(one, probe)]
        if known:
            return _doubled(probe, max(known, key=lambda one: one.err), size)
    return "Plan captures of edges at two angles or more: without them nothing can be said."


def _is_known(prediction: Prediction, want: Want) -> bool:
    has_scale = not want.is_relative or bool(prediction.value)
    return prediction.undetermined is None and bool(prediction.variances) and has_scale


def _scale(prediction: Prediction, want: Want) -> float:
    return abs(prediction.value or 0.0) if want.is_relative else 1.0


def _wanted_variance(want: Want, prediction: Prediction) -> float:
    return (want.half_width * _scale(prediction, want) / prediction.half_width_factor) ** 2


def _moved(prediction: Prediction, levers: frozenset[Lever]) -> float:
    """Variance that these levers divide."""
    return sum(value for source, value in prediction.variances.items() if LEVERS[source] & levers)


def _number(want: Want, prediction: Prediction, lever: Lever, size: PlanSize) -> int | None:
    """How many it takes if nothing else grows; None where that is not enough."""
    moved = _moved(prediction, frozenset({lever}))
    left = _wanted_variance(want, prediction) - (sum(prediction.variances.values()) - moved)
    if left <= 0 or moved <= 0:
        return None
    number = ceil(moved / left * size.now(lever) * (1 - _SLACK))
    return number if number <= _MOST[lever] else None


def _needs(want: Want, prediction: Prediction, size: PlanSize) -> StudyNeeds:
    needs = StudyNeeds(
        frames_per_capture=_number(want, prediction, "frames", size),
        edges=_number(want, prediction, "edges", size),
        session_runs=_number(want, prediction, "runs", size),
        photographs=_number(want, prediction, "photographs", size),
    )
    if needs != StudyNeeds():
        return needs
    return _together(want, prediction, size)


def _together(want: Want, prediction: Prediction, size: PlanSize) -> StudyNeeds:
    """Runs of the plan and photographs that do it together, in the least time.

    With variances a / m + b / p from the runs and the photographs, each a multiple of the present
    number, the time ``m t + p u`` is least for m and p as ``sqrt(a / t)`` and ``sqrt(b / u)``.
    """
    by_runs = _moved(prediction, frozenset({"runs"}))
    by_scene = _moved(prediction, frozenset({"photographs"}))
    total = sum(prediction.variances.values())
    left = _wanted_variance(want, prediction) - (total - by_runs - by_scene)
    if left <= 0:
        return StudyNeeds()
    run_s, scene_s = size.run_s, _PHOTOGRAPH_S * size.photographs
    both = (sqrt(by_runs * run_s) + sqrt(by_scene * scene_s)) / left
    runs = max(ceil(both * sqrt(by_runs / run_s)), 1)
    if by_runs / runs >= left:
        return StudyNeeds()
    factor = by_scene / (left - by_runs / runs)
    photographs = max(ceil(factor * size.photographs), size.photographs)
    if runs > _MOST["runs"] or photographs > _MOST["photographs"]:
        return StudyNeeds()
    return StudyNeeds(session_runs=runs, photographs=photographs, is_together=True)


def _offers(needs: StudyNeeds) -> Iterator[tuple[Lever, int]]:
    numbers: dict[Lever, int | None] = {
        "photographs": needs.photographs,
        "frames": needs.frames_per_capture,
        "runs": needs.session_runs,
        "edges": needs.edges,
    }
    return ((lever, number) for lever, number in numbers.items() if number is not None)


def _sentence(
    want: Want, prediction: Prediction, needs: StudyNeeds, size: PlanSize, *, reached: bool
) -> str:
    name = SPOKEN[want.name]
    wanted = want.text(want.half_width)
    predicted = want.text(prediction.half_width_95 / _scale(prediction, want))
    if reached:
        return f"The plan is enough: {name} is known to {predicted}, {wanted} is wanted."
    offers = dict(_offers(needs))
    if not offers:
        return (
            f"{name[0].upper()}{name[1:]} cannot be known to {wanted}: {_bound(want, prediction)}."
        )
    if needs.is_together:
        return (
            f"Run the plan {needs.session_runs} times and take {needs.photographs} photographs of "
            f"the scene: {name} is then known to {wanted}."
        )
    lever = min(offers, key=lambda one: size.seconds(one, offers[one]))
    note = _hardly(prediction) if lever == "photographs" else _bounded(want, prediction, needs)
    return f"{_order(lever, offers[lever], size)}: {name} is then known to {wanted}{note}."


def _order(lever: Lever, wanted: int, size: PlanSize) -> str:
    if lever == "photographs":
        more = wanted - size.photographs
        return f"Take {more} more photograph{'s' * (more > 1)} of the scene"
    if lever == "frames":
        return f"Average {wanted} frames a capture instead of {size.frames}"
    if lever == "runs":
        return f"Run the plan {wanted} times, focusing anew"
    return f"Photograph {wanted} edges instead of {size.edges}"


def _hardly(prediction: Prediction) -> str:
    small = prediction.share("pixel noise of the edges") < _HARDLY
    return "; frames and edges hardly matter" if small else ""


def _bounded(want: Want, prediction: Prediction, needs: StudyNeeds) -> str:
    """Why frames do not do it, where they do not."""
    focus = prediction.variances.get("focus from capture to capture", 0.0)
    if needs.frames_per_capture is not None or focus == 0:
        return ""
    half_width = prediction.half_width_factor * sqrt(focus) / _scale(prediction, want)
    return f"; frames alone end at {want.text(half_width)}, which the focus leaves"


def _bound(want: Want, prediction: Prediction) -> str:
    """What stays, whatever is done."""
    stay = {source: v for source, v in prediction.variances.items() if not LEVERS[source]}
    if stay and sum(stay.values()) >= _wanted_variance(want, prediction):
        source = max(stay, key=lambda one: stay[one])
        left = prediction.half_width_factor * sqrt(stay[source]) / _scale(prediction, want)
        return f"the {source} leaves {want.text(left)}; measure it with more flats"
    return f"the {prediction.largest} is too large, even with 1000 runs of the plan"


def _doubled(want: Want, prediction: Prediction, size: PlanSize) -> str:
    """What twice as much of what matters most brings."""
    name, source = SPOKEN[want.name], prediction.largest
    now = want.text(prediction.half_width_95 / _scale(prediction, want))
    levers = LEVERS[source] if source is not None else frozenset[Lever]()
    if not levers:
        return f"Measure the {source} with more flats: it limits {name}, known to {now}."
    lever = min(levers, key=lambda one: size.seconds(one, 2 * size.now(one)))
    total = sum(prediction.variances.values())
    better = sqrt(1 - 0.5 * _moved(prediction, frozenset({lever})) / total)
    then = want.text(better * prediction.half_width_95 / _scale(prediction, want))
    note = _hardly(prediction) if lever == "photographs" else ""
    order = _order(lever, 2 * size.now(lever), size)
    return f"{order}: {name} is then known to {then} instead of {now}{note}."
