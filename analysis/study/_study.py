"""Each predicted quantity with its error by source, and the cheapest way to the error wanted.

Each source of an error shrinks with the root of the number of something: frames, edges, runs of the
plan, photographs of the scene. How many of one alone, or of several together, follows in closed
form.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Literal

import numpy as np
from scipy.stats import t as student_t

from analysis.study._change_errors import (
    ChangeSensitivities,
    Sensitivity,
    StudiedScene,
    change_sensitivities,
)
from analysis.study._document import (
    BudgetShare,
    PredictedQuantity,
    Quantity,
    StudiedWant,
    StudyNeeds,
)
from analysis.study._edges import (
    HALF_NYQUIST_CY_PER_PX,
    EdgeSession,
    TransferModel,
    WidthErrors,
    transfer_errors,
    width_errors,
)
from analysis.study._pupil_errors import BoardSession, pupil_errors
from calibration.estimate import NORMAL_95
from simulation.psf import GaussianPsf, Psf

Source = Literal[
    "pixel noise of the edges",
    "focus from capture to capture",
    "photographs of the scene",
    "noise of the camera",
    "pixel noise of the board",
    "heights read back",
]

_Lever = Literal["frames", "edges", "runs", "photographs"]

_LEVERS: Mapping[Source, frozenset[_Lever]] = {
    "pixel noise of the edges": frozenset({"frames", "edges", "runs"}),
    "focus from capture to capture": frozenset({"runs"}),
    "photographs of the scene": frozenset({"photographs"}),
    "noise of the camera": frozenset(),
    "pixel noise of the board": frozenset({"frames", "runs"}),
    "heights read back": frozenset({"runs"}),
}
"""What divides the variance by a source: twice as many of it, half the variance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A quantity, and the variances of its predicted error by source.

    ``value``: what is known of it; None if nothing is. ``variances``: in the quantity's unit,
    squared; empty if the plan does not determine it. ``half_width_factor``: half a 95 % interval in
    standard errors. ``undetermined``: why there is no error.
    """

    quantity: Quantity
    value: float | None
    variances: Mapping[Source, float]
    half_width_factor: float = NORMAL_95
    undetermined: str | None = None

    @property
    def err(self) -> float:
        """Standard error by all sources."""
        return sqrt(sum(self.variances.values()))

    @property
    def half_width_95(self) -> float:
        """Half a 95 % interval."""
        return self.half_width_factor * self.err

    def share(self, source: Source) -> float:
        """Share of a source in the variance."""
        total = sum(self.variances.values())
        return self.variances.get(source, 0.0) / total if total > 0 else 0.0

    @property
    def largest(self) -> Source | None:
        """Source of most of the variance; None where there is none."""
        return max(self.variances, key=lambda source: self.variances[source], default=None)

    def document(self) -> PredictedQuantity:
        """Return it as the document lists it."""
        if self.undetermined is not None or not self.variances:
            return PredictedQuantity(
                quantity=self.quantity,
                value=self.value,
                undetermined=self.undetermined or "the plan does not determine it",
            )
        value, err, half = self.value, self.err, self.half_width_95
        shares = {source: self.share(source) for source in self.variances}
        return PredictedQuantity(
            quantity=self.quantity,
            value=value,
            err=err,
            relative_err=None if not value else err / abs(value),
            half_width_95=half,
            interval_95=None if value is None else (value - half, value + half),
            budget=tuple(
                BudgetShare(source=source, share=share)
                for source, share in sorted(shares.items(), key=lambda pair: -pair[1])
            ),
        )


_NO_EDGES = "the plan has no capture of kind edge"
_NO_BOARD = (
    "the plan has no two captures of kind board, at different heights, with 12 corners in view"
)
_NO_LIMIT = "up to zoom 2.5 nothing limits it, or d' is below the threshold at equal poses"
_NO_CAMERA = "the size of the frame is not known: give the bench a region_px"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudiedPlan:
    """All that a study looks at.

    ``edges``: the planned edges; None without any. ``psf, gaussian``: total PSF as measured, and
    the Gaussian nearest to it. ``transfer``: its transfer function. ``board``: the planned captures
    of a board; None without any, or where the frame is not known. ``pupil_offset_mm``: known from
    an earlier session; None if not.
    """

    edges: EdgeSession | None
    psf: Psf
    gaussian: GaussianPsf
    transfer: TransferModel
    board: BoardSession | None
    pupil_offset_mm: float | None
    scene: StudiedScene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyPredictions:
    """The predictions, and the sensitivities of d'."""

    predictions: tuple[Prediction, ...]
    sensitivities: ChangeSensitivities


def studied(plan: StudiedPlan) -> StudyPredictions:
    """Predict the error of every quantity."""
    widths = None
    if plan.edges is not None:
        widths = width_errors(plan.edges, plan.gaussian.covariance_px2)
    sensitivities = change_sensitivities(plan.scene, plan.psf, plan.gaussian)
    found = [
        _width(plan, widths, 0, "sigma_x_px"),
        _width(plan, widths, 1, "sigma_y_px"),
        _transfer(plan, "transfer_x", (HALF_NYQUIST_CY_PER_PX, 0.0)),
        _transfer(plan, "transfer_y", (0.0, HALF_NYQUIST_CY_PER_PX)),
        _pupil(plan),
        _change(plan, widths, sensitivities.d_prime, "d_prime", ""),
        _change(
            plan,
            widths,
            sensitivities.tilt_deg,
            "tilt_limit_deg",
            _NO_CAMERA if plan.scene.camera is None else _NO_LIMIT,
        ),
    ]
    return StudyPredictions(predictions=tuple(found), sensitivities=sensitivities)


def _width(
    plan: StudiedPlan, widths: WidthErrors | None, axis: int, quantity: Quantity
) -> Prediction:
    value = (plan.gaussian.sigma_x_px, plan.gaussian.sigma_y_px)[axis]
    if widths is None:
        return Prediction(quantity=quantity, value=value, variances={}, undetermined=_NO_EDGES)
    if not widths.is_determined[axis]:
        edges = ("vertical", "horizontal")[axis]
        return Prediction(
            quantity=quantity,
            value=value,
            variances={},
            undetermined=f"the plan has no {edges} edges, nor edges at three angles",
        )
    return Prediction(
        quantity=quantity,
        value=value,
        variances={
            "pixel noise of the edges": float(widths.pixels[axis, axis]),
            "focus from capture to capture": float(widths.focus[axis, axis]),
        },
    )


def _transfer(plan: StudiedPlan, quantity: Quantity, freq: tuple[float, float]) -> Prediction:
    if plan.edges is None:
        fx, fy = (np.array([one]) for one in freq)
        value = float(plan.transfer.of(plan.transfer.parameters)(fx, fy)[0])
        return Prediction(quantity=quantity, value=value, variances={}, undetermined=_NO_EDGES)
    errors = transfer_errors(plan.edges, plan.transfer, freq, plan.gaussian.covariance_px2)
    if errors.pixels is None or errors.focus is None:
        return Prediction(
            quantity=quantity,
            value=errors.value,
            variances={},
            undetermined="the planned angles do not determine a transfer function of this form",
        )
    return Prediction(
        quantity=quantity,
        value=errors.value,
        variances={
            "pixel noise of the edges": errors.pixels,
            "focus from capture to capture": errors.focus,
        },
    )


def _pupil(plan: StudiedPlan) -> Prediction:
    errors = None if plan.board is None else pupil_errors(plan.board)
    if errors is None:
        return Prediction(
            quantity="pupil_offset_mm",
            value=plan.pupil_offset_mm,
            variances={},
            undetermined=_NO_BOARD,
        )
    factor = NORMAL_95
    if errors.heights > 0 and errors.degrees_of_freedom > 0:
        factor = float(student_t.ppf(0.975, errors.degrees_of_freedom))
    return Prediction(
        quantity="pupil_offset_mm",
        value=plan.pupil_offset_mm,
        variances={"pixel noise of the board": errors.pixels, "heights read back": errors.heights},
        half_width_factor=factor,
    )


def _change(
    plan: StudiedPlan,
    widths: WidthErrors | None,
    sensitivity: Sensitivity | None,
    quantity: Quantity,
    why_none: str,
) -> Prediction:
    """A quantity that follows from the PSF, the noise and the scene."""
    if sensitivity is None:
        return Prediction(quantity=quantity, value=None, variances={}, undetermined=why_none)
    if widths is None or not all(widths.is_determined[:2]):
        return Prediction(
            quantity=quantity,
            value=sensitivity.value,
            variances={},
            undetermined="the planned edges do not determine the PSF along both axes",
        )
    slope = sensitivity.by_widths
    variances: dict[Source, float] = {
        "pixel noise of the edges": float(slope @ widths.pixels @ slope),
        "focus from capture to capture": float(slope @ widths.focus @ slope),
        "noise of the camera": (sensitivity.by_log_noise * plan.scene.noise_relative_err) ** 2,
        "photographs of the scene": sensitivity.scene_err**2,
    }
    return Prediction(quantity=quantity, value=sensitivity.value, variances=variances)


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

_SPOKEN: dict[WantName, str] = {
    "sigma": "sigma",
    "transfer": "the transfer at half Nyquist",
    "pupil": "the pupil offset",
    "dprime": "d' at zoom 1.5",
    "tilt": "the tilt limit",
}

_MOST: dict[_Lever, int] = {"frames": 1000, "edges": 100_000, "runs": 1000, "photographs": 100_000}
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

    def now(self, lever: _Lever) -> int:
        """Present number."""
        known: dict[_Lever, int] = {
            "frames": self.frames,
            "edges": self.edges,
            "runs": 1,
            "photographs": self.photographs,
        }
        return known[lever]

    def seconds(self, lever: _Lever, wanted: int) -> float:
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
            sentence=f"Nothing can be said of {_SPOKEN[want.name]}: {why}.",
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
        return "Run the plan: it is enough for everything that is wanted."
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


def _moved(prediction: Prediction, levers: frozenset[_Lever]) -> float:
    """Variance that these levers divide."""
    return sum(value for source, value in prediction.variances.items() if _LEVERS[source] & levers)


def _number(want: Want, prediction: Prediction, lever: _Lever, size: PlanSize) -> int | None:
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


def _offers(needs: StudyNeeds) -> Iterator[tuple[_Lever, int]]:
    numbers: dict[_Lever, int | None] = {
        "photographs": needs.photographs,
        "frames": needs.frames_per_capture,
        "runs": needs.session_runs,
        "edges": needs.edges,
    }
    return ((lever, number) for lever, number in numbers.items() if number is not None)


def _sentence(
    want: Want, prediction: Prediction, needs: StudyNeeds, size: PlanSize, *, reached: bool
) -> str:
    name = _SPOKEN[want.name]
    wanted = want.text(want.half_width)
    predicted = want.text(prediction.half_width_95 / _scale(prediction, want))
    if reached:
        return f"The plan is enough: {name} is known to {predicted}; {wanted} is wanted."
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


def _order(lever: _Lever, wanted: int, size: PlanSize) -> str:
    if lever == "photographs":
        more = wanted - size.photographs
        return f"Take {more} more photograph{'s' * (more > 1)} of the scene"
    if lever == "frames":
        return f"Average {wanted} frames a capture instead of {size.frames}"
    if lever == "runs":
        return f"Run the plan {wanted} times, refocusing each time"
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
    return f"; more frames alone reach {want.text(half_width)} at best, because of the focus"


def _bound(want: Want, prediction: Prediction) -> str:
    """What stays, whatever is done."""
    stay = {source: v for source, v in prediction.variances.items() if not _LEVERS[source]}
    if stay and sum(stay.values()) >= _wanted_variance(want, prediction):
        source = max(stay, key=lambda one: stay[one])
        left = prediction.half_width_factor * sqrt(stay[source]) / _scale(prediction, want)
        return f"the {source} leaves {want.text(left)}; measure it with more flats"
    return f"the {prediction.largest} is too large, even with 1000 runs of the plan"


def _doubled(want: Want, prediction: Prediction, size: PlanSize) -> str:
    """What twice as much of what matters most brings."""
    name, source = _SPOKEN[want.name], prediction.largest
    now = want.text(prediction.half_width_95 / _scale(prediction, want))
    levers = _LEVERS[source] if source is not None else frozenset[_Lever]()
    if not levers:
        return f"Measure the {source} with more flats: it limits {name}, known to {now}."
    lever = min(levers, key=lambda one: size.seconds(one, 2 * size.now(one)))
    total = sum(prediction.variances.values())
    better = sqrt(1 - 0.5 * _moved(prediction, frozenset({lever})) / total)
    then = want.text(better * prediction.half_width_95 / _scale(prediction, want))
    note = _hardly(prediction) if lever == "photographs" else ""
    order = _order(lever, 2 * size.now(lever), size)
    return f"{order}: {name} is then known to {then} instead of {now}{note}."
