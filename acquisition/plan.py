"""The capture plan: targets, orientations and heights in working order, and its cost."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    model_validator,
)

from acquisition.bench import BenchConfig
from acquisition.choices import CaptureKind
from acquisition.errors import PlanError
from acquisition.written_files import (
    WrittenTable,
    read_toml,
    validate_written,
    validation_keys,
    validation_lines,
)

HEIGHT_DECIMALS = 3
"""Heights are distinguished to 0.001 mm, as in file names."""

_MAX_HEIGHTS = 10_000
_RAMP_S = 0.3
"""Acceleration and deceleration of one move."""

_OVERHEAD_S = 0.25
"""Starting and stopping the stream, reading the stage twice, storing the capture."""


def _expand_heights(value: object) -> object:
    """Turn a table of start, stop and step into the list of its heights."""
    if not isinstance(value, Mapping):
        return value
    if set(value) != {"start", "stop", "step"}:
        raise ValueError(f"a table must have start, stop and step, got {', '.join(value)}")
    numbers = [value[key] for key in ("start", "stop", "step")]
    if not all(type(number) in (int, float) and math.isfinite(number) for number in numbers):
        raise ValueError(f"start, stop and step must be finite numbers, got {numbers}")
    start, stop, step = map(float, numbers)
    if not (step > 0 and stop >= start):
        raise ValueError(f"step must be positive and stop not below start, got {numbers}")
    steps = (stop - start) / step
    if steps >= _MAX_HEIGHTS:
        raise ValueError(f"more than {_MAX_HEIGHTS} heights")
    if abs(steps - round(steps)) > 1e-6:
        raise ValueError(f"stop {stop:g} is not a whole number of steps {step:g} from {start:g}")
    return [round(start + i * step, 6) for i in range(round(steps) + 1)]


def _as_ladder(value: object) -> object:
    """Turn a single exposure into a list of one."""
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


def _distinct(key: Callable[[float], float] = float) -> AfterValidator:
    """Refuse values of which two have the same key."""

    def check(values: tuple[float, ...]) -> tuple[float, ...]:
        seen: set[float] = set()
        for value in values:
            if key(value) in seen:
                raise ValueError(f"{value:g} is given twice")
            seen.add(key(value))
        return values

    return AfterValidator(check)


def _check_text(text: str) -> str:
    if not text.strip() or not text.isprintable():
        raise ValueError("must be printable text and not empty")
    return text


_Heights = Annotated[
    tuple[Annotated[float, Field(allow_inf_nan=False)], ...],
    BeforeValidator(_expand_heights),
    Field(min_length=1, max_length=_MAX_HEIGHTS),
    _distinct(key=lambda height: round(height, HEIGHT_DECIMALS)),
]

Orientations = Annotated[
    tuple[Annotated[float, Field(ge=0, lt=360)], ...],
    Field(min_length=1),
    _distinct(),
]

_Exposures = Annotated[
    tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...],
    BeforeValidator(_as_ladder),
    Field(min_length=1, max_length=1000),
    _distinct(),
]

Text = Annotated[str, Field(max_length=200), AfterValidator(_check_text)]


class ExposureBracket(WrittenTable):
    """``bracket``: several exposures at each height, merged to one capture of linear light."""

    exposures: int = Field(ge=2, le=12, description="number of exposures")
    ratio: float = Field(
        8.0,
        ge=1.5,
        le=32,
        description="ratio of each exposure to the one before; the first is exposure_us",
    )

    def ratios(self) -> tuple[float, ...]:
        """The exposures as multiples of the first."""
        return tuple(self.ratio**number for number in range(self.exposures))


class PlanTarget(WrittenTable):
    """``[[targets]]``: one target, at its orientations, over its own or the plan's heights."""

    kind: CaptureKind
    target: Text
    orientations_deg: Orientations = (0.0,)
    heights_mm: _Heights | None = None
    exposure_us: _Exposures | None = Field(None, description="one or a list; default: the bench's")
    bracket: ExposureBracket | None = Field(
        None, description="exposures merged into one capture; exposure_us is the shortest"
    )
    reference: Text | None = Field(
        None,
        description="earlier photograph of the target, named from the plan file; each capture is "
        "compared with it",
    )


class CapturePlan(WrittenTable):
    """A capture plan: targets, heights and exposures; ``preview_plan`` lists its captures."""

    schema_: Literal["standoff.plan/1"] = Field(alias="schema")
    name: Text
    heights_mm: _Heights | None = Field(None, description="for targets without their own")
    frames_per_capture: int | None = Field(None, ge=2, le=1000, description="default: the bench's")
    keep_frames: bool = Field(False, description="also store the raw frames")
    repeats: int = Field(1, ge=1, le=1000, description="captures at each height")
    order: Literal["ascending", "descending"] = Field(
        "ascending", description="order of the heights; descending for stages approached from above"
    )
    settle_s: float = Field(
        0.0, ge=0, le=3600, description="extra wait after each move, beyond the bench's"
    )
    auto_exposure: bool = Field(
        False, description="set the exposure at the first capture of a target, then keep it"
    )
    drift_check: bool = Field(
        False, description="capture the first height of each orientation again at its end"
    )
    targets: Annotated[tuple[PlanTarget, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _targets_are_complete_and_distinct(self) -> "CapturePlan":
        seen: set[tuple[str, str, float]] = set()
        for number, target in enumerate(self.targets):
            if target.heights_mm is None and self.heights_mm is None:
                raise ValueError(f"targets.{number}.heights_mm: set neither here nor for the plan")
            for orientation_deg in target.orientations_deg:
                pose = (target.kind, target.target, orientation_deg)
                if pose in seen:
                    raise ValueError(
                        f"targets.{number}: {target.kind} {target.target!r} at "
                        f"{orientation_deg:g} degrees is planned twice"
                    )
                seen.add(pose)
        return self

    def to_json(self) -> dict[str, Any]:
        """The plan as a JSON object, which ``parse_plan`` reads."""
        return self.model_dump(mode="json", by_alias=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanEntry:
    """One planned capture; ``index`` is its number in the plan, from 0."""

    index: int
    kind: CaptureKind
    target: str
    orientation_deg: float
    height_mm: float
    repeat: int = 0
    exposure_us: float | None = None
    bracket: ExposureBracket | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(CaptureKind):
            raise ValueError(f"kind must be one of {get_args(CaptureKind)}, got {self.kind!r}")

    @property
    def placement(self) -> tuple[str, str, float]:
        """Kind, target and orientation: what the operator sets up by hand."""
        return self.kind, self.target, self.orientation_deg

    @property
    def stem(self) -> str:
        """File name without its ending, such as ``0007_edge-090_h0123.400mm``."""
        whole, dot, fraction = f"{self.orientation_deg:.6f}".rstrip("0").partition(".")
        orientation = whole.zfill(3) + (dot + fraction if fraction else "")
        return f"{self.index:04d}_{self.kind}-{orientation}_h{self.height_mm:08.3f}mm"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanEstimate:
    """Cost of a plan: numbers of captures and of placements by the operator, time and disk space.

    ``seconds`` does not include the placements; ``bytes_`` is None if the size of a frame is not
    known.
    """

    captures: int
    placements: int
    seconds: float
    bytes_: int | None


def load_plan(path: Path) -> CapturePlan:
    """Read a plan file."""
    try:
        return validate_written(CapturePlan, read_toml(path))
    except ValidationError as error:
        raise _plan_error(error, f"plan file {path}") from error
    except OSError as error:
        raise PlanError(f"plan file {path}: {error.strerror}", path=path) from error
    except ValueError as error:
        raise PlanError(f"plan file {path}: {error}", path=path) from error


def parse_plan(table: Mapping[str, Any], *, source: str) -> CapturePlan:
    """Validate a plan given as a table; a ``PlanError`` message starts with ``source``."""
    try:
        return CapturePlan.model_validate(table)
    except ValidationError as error:
        raise _plan_error(error, source) from error


def _plan_error(error: ValidationError, source: str) -> PlanError:
    lines = validation_lines(error, CapturePlan)
    return PlanError(f"{source}: {lines}", keys=validation_keys(error))


def plan_entries(plan: CapturePlan) -> tuple[PlanEntry, ...]:
    """Captures of the plan, numbered from 0 in working order.

    For each target and orientation the heights ascend, or descend if the plan says so, so that a
    stage with backlash approaches from one side. At one height the exposures follow as they are
    written, and the whole list is repeated. With a drift check, the first height is captured once
    more at the end.
    """
    poses = (
        (target, orientation_deg, *each)
        for target in plan.targets
        for orientation_deg in target.orientations_deg
        for each in _series(plan, target)
    )
    return tuple(
        PlanEntry(
            index=index,
            kind=target.kind,
            target=target.target,
            orientation_deg=orientation_deg,
            height_mm=height_mm,
            repeat=repeat,
            exposure_us=exposure_us,
            bracket=target.bracket,
        )
        for index, (target, orientation_deg, height_mm, repeat, exposure_us) in enumerate(poses)
    )


def bytes_per_pixel(entry: PlanEntry, frames: int, *, keep_frames: bool) -> int:
    """Bytes that a capture stores for each pixel: its pages, and the raw frames."""
    if entry.bracket is None:
        return 2 * 4 + (2 * frames if keep_frames else 0)
    return 3 * 4 + (2 * frames * entry.bracket.exposures if keep_frames else 0)


def estimate_plan(
    plan: CapturePlan,
    entries: Sequence[PlanEntry],
    bench: BenchConfig,
    frame_shape: tuple[int, int] | None,
) -> PlanEstimate:
    """Estimate the cost of capturing entries of a plan, from the middle of the travel."""
    frames = plan.frames_per_capture or bench.capture.frames_per_capture
    stage = bench.stage
    height_mm = math.fsum(stage.limits_mm) / 2
    seconds = 0.0
    placements = 0
    placed: tuple[str, str, float] | None = None
    approached: float | None = None
    for entry in entries:
        if entry.placement != placed:
            placed, approached = entry.placement, None
            placements += 1
        if entry.height_mm != approached:
            travel_mm = abs(entry.height_mm - height_mm)
            is_wrong_side = (entry.height_mm < height_mm) == (stage.approach == "from_below")
            travel_mm += 2 * stage.backlash_mm * is_wrong_side
            seconds += _RAMP_S + 60 * travel_mm / stage.feed_mm_per_min
            seconds += stage.settle_s + plan.settle_s
            height_mm = approached = entry.height_mm
        exposure_s = 1e-6 * (entry.exposure_us or bench.camera.exposure_us)
        for ratio in (1.0,) if entry.bracket is None else entry.bracket.ratios():
            period_s = max(1 / bench.camera.frame_rate_hz, ratio * exposure_s)
            seconds += _OVERHEAD_S + (frames + 1) * period_s
    size = None
    if frame_shape is not None:
        per_pixel = (bytes_per_pixel(e, frames, keep_frames=plan.keep_frames) for e in entries)
        size = math.prod(frame_shape) * sum(per_pixel)
    return PlanEstimate(captures=len(entries), placements=placements, seconds=seconds, bytes_=size)


def _series(plan: CapturePlan, target: PlanTarget) -> Iterator[tuple[float, int, float | None]]:
    """Heights, repeats and exposures of one orientation of a target."""
    heights_mm = sorted(
        target.heights_mm or plan.heights_mm or (), reverse=plan.order == "descending"
    )
    exposures_us = target.exposure_us or (None,)
    for height_mm in heights_mm:
        for repeat in range(plan.repeats):
            for exposure_us in exposures_us:
                yield height_mm, repeat, exposure_us
    if plan.drift_check:
        yield heights_mm[0], plan.repeats, exposures_us[0]
