"""Capture plans as they are typed on a page: checked, written as TOML, and chosen from folders."""

import json
import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from os.path import lexists
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from acquisition.choices import CaptureKind
from acquisition.errors import PlanError
from acquisition.plan import CapturePlan, load_plan, parse_plan
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_toml
from acquisition.written_files import validation_keys
from standoff.console.page_words import requirement
from standoff.console.session_library import is_session_name
from standoff.errors import ApplicationError
from standoff.library import make_folder, write_file

SOURCE = "plan"
MOST_CAPTURES = 100_000
MOST_TARGETS = 100
MOST_FAULTS = 4
SHORTEST_SERIES = 4
LABELS = {
    "heights_mm": "heights",
    "frames_per_capture": "frames of a capture",
    "orientations_deg": "orientations",
    "exposure_us": "exposures",
    "settle_s": "wait after a move",
    "bracket.exposures": "exposures of the bracket",
    "bracket.ratio": "ratio of the bracket",
}
"""What the page calls the keys of a plan file; others by themselves."""

_KEY = re.compile(
    r"targets\.(?P<number>\d+)(?:\.(?P<own>(?:bracket\.)?[a-z_]+))?"
    rf"|\b(?P<field>{'|'.join(map(re.escape, LABELS))})\b"
)
UNITS = {"heights_mm": " mm", "exposure_us": " µs", "orientations_deg": "°", "settle_s": " s"}

_SERIES = re.compile(r"(\S+) to (\S+) step (\S+)")
_KEYS_WRITTEN = (
    "schema",
    "name",
    "heights_mm",
    "frames_per_capture",
    "keep_frames",
    "repeats",
    "order",
    "settle_s",
    "auto_exposure",
    "drift_check",
)

Words = Annotated[str, Field(max_length=2000)]
Count = Annotated[int, Field(ge=0, le=10**6)]


class DraftError(ApplicationError):
    """A draft is not a plan; ``keys`` are those of the fields at fault, as in a plan file."""

    def __init__(self, text: str, keys: tuple[str, ...]) -> None:
        super().__init__(text)
        self.keys = keys


class _Draft(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class TargetDraft(_Draft):
    """One target; numbers as they were typed, empty for the plan's or the bench's own.

    ``bracket_exposures`` is 0 for captures of one exposure.
    """

    kind: CaptureKind
    target: Words
    orientations: Words = ""
    heights: Words = ""
    exposures: Words = ""
    bracket_exposures: Count = 0
    bracket_ratio: Annotated[float, Field(allow_inf_nan=False)] = 8.0
    reference: Words = ""


class PlanDraft(_Draft):
    """A plan as it was typed; ``frames`` is 0 for the bench's own."""

    name: Words
    heights: Words = ""
    frames: Count = 0
    keep_frames: bool = False
    repeats: Count = 1
    order: Literal["ascending", "descending"] = "ascending"
    settle_s: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    auto_exposure: bool = False
    drift_check: bool = False
    targets: Annotated[tuple[TargetDraft, ...], Field(max_length=MOST_TARGETS)]


def plan_of(draft: PlanDraft) -> CapturePlan:
    """Read and check a draft."""
    table: dict[str, Any] = {
        "schema": "standoff.plan/1",
        "name": draft.name,
        **{key: getattr(draft, key) for key in ("keep_frames", "repeats", "order", "settle_s")},
        "auto_exposure": draft.auto_exposure,
        "drift_check": draft.drift_check,
        "targets": [_target(target, number) for number, target in enumerate(draft.targets)],
    }
    if draft.heights.strip():
        table["heights_mm"] = _numbers(draft.heights, "heights_mm")
    if draft.frames:
        table["frames_per_capture"] = draft.frames
    try:
        plan = CapturePlan.model_validate(table)
    except ValidationError as error:
        faults = error.errors()
        text = "; ".join(_fault_text(fault) for fault in faults[:MOST_FAULTS])
        raise _fault(text, validation_keys(error)) from error
    captures = captures_in(plan)
    if captures > MOST_CAPTURES:
        raise DraftError(f"{captures} captures; at most {MOST_CAPTURES} are allowed", ("repeats",))
    return plan


def captures_in(plan: CapturePlan) -> int:
    """Number of captures of a plan, without listing them."""
    return sum(
        len(target.orientations_deg)
        * (
            len(target.heights_mm or plan.heights_mm or ())
            * plan.repeats
            * len(target.exposure_us or (None,))
            + plan.drift_check
        )
        for target in plan.targets
    )


def draft_of(plan: CapturePlan) -> PlanDraft:
    """The draft that becomes a plan, for editing it."""
    return PlanDraft(
        name=plan.name,
        heights=_heights_text(plan.heights_mm),
        frames=plan.frames_per_capture or 0,
        keep_frames=plan.keep_frames,
        repeats=plan.repeats,
        order=plan.order,
        settle_s=plan.settle_s,
        auto_exposure=plan.auto_exposure,
        drift_check=plan.drift_check,
        targets=tuple(
            TargetDraft(
                kind=target.kind,
                target=target.target,
                orientations=_text(target.orientations_deg),
                heights=_heights_text(target.heights_mm),
                exposures=_text(target.exposure_us),
                bracket_exposures=0 if target.bracket is None else target.bracket.exposures,
                bracket_ratio=8.0 if target.bracket is None else target.bracket.ratio,
                reference=target.reference or "",
            )
            for target in plan.targets
        ),
    )


def plan_toml(plan: CapturePlan) -> str:
    """A plan as the text of a plan file, which reads back as the same plan."""
    table = plan.to_json()
    lines = [_line(key, table[key]) for key in _KEYS_WRITTEN if table[key] is not None]
    for target in table["targets"]:
        facts = {key: value for key, value in target.items() if value is not None}
        lines += ["", "[[targets]]", *(_line(key, value) for key, value in facts.items())]
    text = "\n".join(lines) + "\n"
    if parse_plan(tomllib.loads(text), source=SOURCE) != plan:
        raise ApplicationError("the plan cannot be written as a file")
    return text


def _fault(text: str, keys: tuple[str, ...]) -> DraftError:
    """The error with the words of the page instead of a plan file's keys."""
    named = tuple(key for key in keys if key)
    if not named:  # of the whole plan: the text begins with the key
        named = tuple(match[0] for match in _KEY.finditer(text))
    return DraftError(_KEY.sub(_label, text), named)


def _fault_text(fault: ErrorDetails) -> str:
    """What is wrong with one value, beginning with the key of its field."""
    *path, last = fault["loc"] or ("",)
    key = ".".join(map(str, path if isinstance(last, int) else (*path, last)))
    unit = next((unit for name, unit in UNITS.items() if name in fault["loc"]), "")
    return f"{key}{requirement(fault, unit)}".removeprefix(": ")


def _label(key: re.Match[str]) -> str:
    """What the page calls the field of a key such as ``targets.0.heights_mm``."""
    if key["number"] is None:
        return LABELS[key["field"]]
    target = f"target {int(key['number']) + 1}"
    return target if key["own"] is None else f"{target}, {LABELS.get(key['own'], key['own'])}"


def _target(draft: TargetDraft, number: int) -> dict[str, Any]:
    key = f"targets.{number}"
    table: dict[str, Any] = {"kind": draft.kind, "target": draft.target}
    for name, text in (
        ("orientations_deg", draft.orientations),
        ("heights_mm", draft.heights),
        ("exposure_us", draft.exposures),
    ):
        if text.strip():
            table[name] = _numbers(text, f"{key}.{name}")
    if isinstance(table.get("exposure_us"), dict):
        raise DraftError("list the exposures, such as 1000 2000 4000", (f"{key}.exposure_us",))
    if isinstance(table.get("orientations_deg"), dict):
        raise DraftError("list the orientations, such as 5 95", (f"{key}.orientations_deg",))
    if draft.bracket_exposures:
        table["bracket"] = {"exposures": draft.bracket_exposures, "ratio": draft.bracket_ratio}
    if draft.reference.strip():
        table["reference"] = draft.reference.strip()
    return table


def _numbers(text: str, key: str) -> list[float] | dict[str, float]:
    """Numbers separated by commas or spaces, or ``A to B step C``."""
    series = _SERIES.fullmatch(text.strip())
    if series is not None:
        start, stop, step = (_number(word, key) for word in series.groups())
        return {"start": start, "stop": stop, "step": step}
    return [_number(word, key) for word in text.replace(",", " ").replace(";", " ").split()]


def _number(word: str, key: str) -> float:
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise _fault(
            f"{key}: {word!r} is not a number; write 250 300, or 180 to 400 step 20", (key,)
        )
    return number


def _heights_text(heights_mm: tuple[float, ...] | None) -> str:
    """Heights as one would type them: a long list of equal steps as a series."""
    if heights_mm is not None and len(heights_mm) >= SHORTEST_SERIES:
        start, step = heights_mm[0], round(heights_mm[1] - heights_mm[0], 6)
        if step > 0 and all(
            round(start + i * step, 6) == height for i, height in enumerate(heights_mm)
        ):
            return f"{start:.10g} to {heights_mm[-1]:.10g} step {step:.10g}"
    return _text(heights_mm)


def _text(numbers: tuple[float, ...] | None) -> str:
    return " ".join(f"{number:.10g}" for number in numbers or ())


def _line(key: str, value: object) -> str:
    return f"{key} = {_value(value)}"


def _value(value: object) -> str:
    """A value as TOML writes it; its strings are those of JSON."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(_line(key, each) for key, each in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


PLAN_SCHEMA = "standoff.plan/1"


class PlanLibrary:
    """Plans by file name, in several folders; of two with the same name, the first counts.

    New plans are written to the first folder.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = tuple(folders)

    def names(self) -> tuple[str, ...]:
        """File names without ``.toml``, in alphabetical order."""
        return tuple(sorted(self._files()))

    def load(self, name: str) -> CapturePlan:
        """Read the plan with that name."""
        path = self._files().get(name)
        if path is None:
            raise ApplicationError(f"there is no plan {name!r}; choose one from the list")
        return load_plan(path)

    def has(self, name: str) -> bool:
        """Whether there is a plan with that name, or another file in its place."""
        return name in self._files() or (
            bool(self._folders) and lexists(self._folders[0] / f"{name}.toml")
        )

    def save(self, name: str, plan: CapturePlan) -> Path:
        """Write a plan to the first folder, in place of an earlier one; return its path."""
        if not is_session_name(name):
            raise ApplicationError(
                "a plan's name has only letters, digits, spaces and . _ + -, and must begin with a "
                "letter or digit"
            )
        if not self._folders:
            raise ApplicationError("the console has no folder of plans; start it with --plans")
        path = make_folder(self._folders[0]) / f"{name}.toml"
        if path.is_symlink() or (path.exists() and not _is_plan(path)):
            raise ApplicationError(f"{path} is not a plan; choose another name")
        write_file(path, plan_toml(plan).encode("utf-8"))
        return path

    def folder_of(self, plan: CapturePlan) -> Path | None:
        """Find the folder that holds a plan, from which its files are named; None if none does."""
        for path in self._files().values():
            try:
                if load_plan(path) == plan:
                    return path.parent
            except PlanError:
                continue
        return None

    def _files(self) -> dict[str, Path]:
        found: dict[str, Path] = {}
        for folder in self._folders:
            for path in sorted(folder.glob("*.toml")):
                if path.stem not in found and _is_plan(path):
                    found[path.stem] = path
        return found


def _is_plan(path: Path) -> bool:
    """Whether a TOML file claims to be a plan; its content is checked when it is loaded."""
    try:
        return parse_toml(read_regular_file(path)).get("schema") == PLAN_SCHEMA
    except (OSError, ValueError):
        return False
