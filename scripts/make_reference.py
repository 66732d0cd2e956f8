"""Writes docs/reference: commands, configs and files from their models, functions from the library.

``make docs`` runs it first, as ``python -m scripts.make_reference``; what it writes is not kept.
"""

import inspect
import types
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from acquisition.bench import (
    BenchConfig,
    CameraConfig,
    CaptureConfig,
    LabelsConfig,
    OpticsConfig,
    SimulatedConfig,
    StageConfig,
)
from acquisition.bracket import BracketExposure
from acquisition.plan import CapturePlan, ExposureBracket, PlanTarget
from acquisition.quantities import PLAUSIBLE, number_text
from acquisition.session import CaptureRecord, EventKind, Manifest
from acquisition.written_files import WrittenTable
from analysis.change_series import (
    ChangesSeries,
    ChangeTimeLine,
    ChangeTrack,
    ComparedFollowup,
    TimeLineFollowup,
    TrackPoint,
)
from analysis.changes import Change, ChangeSummary
from analysis.detectability import DetectabilityCurve, DetectabilityCurves
from analysis.evaluation import (
    Evaluation,
    EvaluationCurve,
    FailedPair,
    FrocPoints,
    RocPoints,
)
from analysis.pose import JudgedFollowup, PoseSeries
from analysis.study import (
    BudgetShare,
    PlanStudy,
    PredictedQuantity,
    StudiedWant,
    StudyNeeds,
)
from calibration.edges import AxisTransfer, EdgeMeasurement, MeasuredTransfer
from calibration.geometry import (
    CaptureGeometry,
    ExcludedCapture,
    GeometryCalibration,
    HeightZoom,
)
from calibration.noise import LevelSample, MapFile, NoiseCalibration
from calibration.provenance import InputFile, Provenance
from calibration.psf import (
    CameraIdentity,
    ColourPsf,
    FieldFit,
    HeightGroup,
    HeightTrend,
    OtfTable,
    PairWidths,
    PsfCalibration,
    Transfer2d,
)
from calibration.sharpness import LimitVerdict, SharpnessLimits, SharpnessVerdict
from scripts.library_reference import library_pages
from standoff.terminal import EXAMPLES, application

REFERENCE = Path(__file__).parents[1] / "docs" / "reference"
MADE = "Made from the code by `python -m scripts.make_reference`; do not edit.\n"


def commands_page() -> str:
    """Every command with its arguments and options."""
    parts = [f"# Commands\n\n{MADE}"]
    root: Any = typer.main.get_command(application([]))
    for name, command in sorted(root.commands.items()):
        parts += _command(f"standoff {name}", command)
    return "\n".join(parts).rstrip() + "\n"


def _command(name: str, command: Any) -> list[str]:  # noqa: ANN401 - typer's own click
    parts = [f"## {name}\n", inspect.cleandoc(command.help or "").replace("\b\n", ""), ""]
    shown = [parameter for parameter in command.params if not getattr(parameter, "hidden", False)]
    if shown:
        parts += ["| | takes | default | |", "| --- | --- | --- | --- |"]
        parts += [_parameter(parameter) for parameter in shown]
        parts.append("")
    if name.removeprefix("standoff ") in EXAMPLES:
        lines = EXAMPLES[name.removeprefix("standoff ")]
        parts += ["```sh", *lines, "```", ""]
    for inner, other in sorted(getattr(command, "commands", {}).items()):
        parts += _command(f"{name} {inner}", other)
    return parts


def _parameter(parameter: Any) -> str:  # noqa: ANN401 - typer's own click
    is_option = parameter.param_type_name == "option"
    names = [*parameter.opts, *parameter.secondary_opts] if is_option else [parameter.name.upper()]
    annotation = parameter.type_descriptor.annotation
    kind = "" if getattr(parameter, "is_flag", False) else _type(annotation)
    default = parameter.default
    if parameter.required:
        shown = "required"
    elif default is None or default is False or callable(default) or isinstance(default, tuple):
        shown = ""
    else:
        value = getattr(default, "value", default)
        shown = f"`{value}`" if isinstance(value, str | int | float | Path) else ""
    text = " ".join((getattr(parameter, "help", None) or "").split())
    return f"| {_code(names)} | {_cell(kind)} | {shown} | {_cell(text)} |"


def _code(names: list[str]) -> str:
    return " ".join(f"`{name}`" for name in names)


def configs_page() -> str:
    """Every key of a bench file, of a capture plan and of a limits file."""
    parts = [f"# Bench files, capture plans and limits\n\n{MADE}"]
    parts += ["All are TOML. A key that is unknown, missing or out of range is an error that names"]
    parts += ["it. Shipped examples are in `configs/`; `--set section.key=value` replaces one key."]
    parts += [
        'A number is in the unit that its key ends in, or states its own as text: `"9 ms"`. One'
    ]
    parts += ["outside the usual range is taken only if it states its unit."]
    parts += ["\n## Bench file\n"]
    for name, section in (
        ("camera", CameraConfig),
        ("stage", StageConfig),
        ("optics", OpticsConfig),
        ("capture", CaptureConfig),
        ("simulated", SimulatedConfig),
        ("labels", LabelsConfig),
    ):
        field = BenchConfig.model_fields[name]
        parts += [f"### [{name}]{'' if field.is_required() else ' (optional)'}\n"]
        parts += _model(section)
    parts += ["## Capture plan\n", *_model(CapturePlan), "### [[targets]]\n", *_model(PlanTarget)]
    parts += ["### bracket of a target (optional)\n", *_model(ExposureBracket)]
    parts += ["## Limits file\n", "For `calibrate --limits`; what is left out is not judged.\n"]
    for name in SharpnessLimits.model_fields:
        parts += [f"### [{name}] (optional)\n", *_model(_table(SharpnessLimits, name))]
    return "\n".join(parts).rstrip() + "\n"


def _table(model: type[BaseModel], name: str) -> type[BaseModel]:
    kind = model.model_fields[name].annotation
    assert isinstance(kind, type)
    assert issubclass(kind, BaseModel)
    return kind


FILES: tuple[tuple[str, str, tuple[type, ...]], ...] = (
    (
        "psf.json",
        "Schema `standoff.psf/1`. Written by `calibrate`; sigma without a prefix is total. A "
        'default of "-" means that the key is required, though it may be null if its type allows.',
        (
            PsfCalibration,
            EdgeMeasurement,
            FieldFit,
            HeightTrend,
            HeightGroup,
            MeasuredTransfer,
            AxisTransfer,
            Transfer2d,
            OtfTable,
            CameraIdentity,
            ColourPsf,
            PairWidths,
            SharpnessVerdict,
            LimitVerdict,
        ),
    ),
    (
        "provenance",
        "In every JSON document that a command writes, under this key; null in older files.",
        (Provenance, InputFile),
    ),
    (
        "noise.json",
        "Schema `standoff.noise/1`. Written by `noise`, with the dark, flat and defect maps beside "
        "it.",
        (NoiseCalibration, MapFile, LevelSample),
    ),
    (
        "geometry.json",
        "Schema `standoff.geometry/1`. Written by `geometry`.",
        (GeometryCalibration, HeightZoom, CaptureGeometry, ExcludedCapture),
    ),
    (
        "curves.json",
        "Schema `standoff.detectability/1`. Written by `detectability`.",
        (DetectabilityCurves, DetectabilityCurve),
    ),
    (
        "evaluation.json",
        "Schema `standoff.evaluation/1`. Written by `evaluate`.",
        (Evaluation, EvaluationCurve, RocPoints, FrocPoints, FailedPair),
    ),
    (
        "study.json",
        "Schema `standoff.study/1`. Written by `plan-study --out`.",
        (PlanStudy, PredictedQuantity, BudgetShare, StudiedWant, StudyNeeds),
    ),
    (
        "changes.json",
        "Schema `standoff.changes/1`. Written by `changes`; changes.csv beside it has the list.",
        (ChangeSummary, Change),
    ),
    (
        "summary.json of changes",
        "Schema `standoff.changes-summary/1`. Written by `changes` for several follow-ups; "
        "changes.csv has the same lines.",
        (ChangesSeries, ComparedFollowup),
    ),
    (
        "series.json of changes",
        "Schema `standoff.changes-series/1`. Written by `changes` for several follow-ups of one "
        "reference: the time line of each change.",
        (ChangeTimeLine, TimeLineFollowup, ChangeTrack, TrackPoint),
    ),
    (
        "summary.json of poses",
        "Schema `standoff.pose-summary/1`. Written by `pose` for several follow-ups; poses.csv has "
        "the same lines without the homography.",
        (PoseSeries, JudgedFollowup),
    ),
    (
        "session.json",
        "Schema `standoff.session/1`. What a capture session was made with; see "
        "[capture-sessions.md](../capture-sessions.md).",
        (Manifest,),
    ),
    (
        "captures/*.tif and journal.jsonl",
        "The record of a capture, as JSON in ImageJ's Info and in the journal's `capture` events. "
        f"Events of the journal: {', '.join(f'`{kind}`' for kind in get_args(EventKind))}.",
        (CaptureRecord, BracketExposure),
    ),
)


def files_page() -> str:
    """Every key of the files that people may read."""
    parts = [f"# File formats\n\n{MADE}"]
    parts += ["All JSON is UTF-8, finite numbers only; units are in the names. `H.json` holds"]
    parts += [
        '`{"schema": "standoff.homography/1", "matrix": 3 x 3, "size": [width, height]}`: the'
    ]
    parts += ["matrix takes follow-up pixel centres (x, y, 1) to those of the reference. With"]
    parts += ['`"distortion_k1": number` both are ideal positions for a lens that images radius r,']
    parts += [
        "1 at the reference's corner, at `r (1 + k1 r^2)`; the follow-up's centre is on the axis.\n"
    ]
    for name, about, models in FILES:
        parts += [f"## {name}\n", about, ""]
        for model in models:
            if len(models) > 1:
                parts += [f"### {model.__name__}\n", _first_paragraph(model), ""]
            parts += _model(model)
    return "\n".join(parts).rstrip() + "\n"


def _model(model: type) -> list[str]:
    rows = ["| key | type | default | |", "| --- | --- | --- | --- |"]
    if issubclass(model, BaseModel):
        is_written = issubclass(model, WrittenTable)
        for name, field in model.model_fields.items():
            if field.exclude:  # not kept in a file
                continue
            asked = _asked(name) if is_written else ""
            about = (field.description, _bounds(field), asked)
            default = "-" if field.is_required() else f"`{_default(field)}`"
            rows.append(
                f"| `{field.alias or name}` | {_cell(_type(field.annotation))} | {_cell(default)} "
                f"| {_cell('; '.join(filter(None, about)))} |"
            )
    else:
        hints = get_type_hints(model)
        rows += [f"| `{name}` | {_cell(_type(hints[name]))} | - | |" for name in _fields(model)]
    return [*rows, ""]


def _fields(model: type) -> tuple[str, ...]:
    return tuple(getattr(model, "__dataclass_fields__", {}))


def _default(field: FieldInfo) -> object:
    value = field.get_default(call_default_factory=True, validated_data={})
    return value.model_dump() if isinstance(value, BaseModel) else value


def _bounds(field: FieldInfo) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    found = [
        f"{sign} {getattr(rule, name)}"
        for rule in field.metadata
        for name, sign in signs.items()
        if getattr(rule, name, None) is not None
    ]
    return ", ".join(found)


def _asked(name: str) -> str:
    """The range outside which a number is asked about."""
    plausible = PLAUSIBLE.get(name)
    if plausible is None:
        return ""
    low, high = number_text(plausible.low), number_text(plausible.high)
    what = {"each": "usual", "largest": "usual largest", "span": "usual span"}[plausible.of]
    return f"{what}: {low} to {high}"


def _type(kind: object) -> str:
    origin, inner = get_origin(kind), get_args(kind)
    if kind is type(None):
        return "null"
    if origin is Literal:
        return ", ".join(f'"{value}"' for value in inner)
    if origin in (Union, types.UnionType):
        return " or ".join(_type(one) for one in inner)
    if origin is not None and hasattr(kind, "__metadata__"):
        return _type(inner[0])
    if inner and origin is not None:
        named = [_type(one) for one in inner if one is not Ellipsis]
        return f"{getattr(origin, '__name__', origin)} of {', '.join(named)}"
    return getattr(kind, "__name__", str(kind))


def _first_paragraph(model: type) -> str:
    return inspect.cleandoc(model.__doc__ or "").split("\n\n")[0].replace("``", "`")


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


PAGES = {"commands.md": commands_page, "configs.md": configs_page, "files.md": files_page}
PAGES |= library_pages(MADE)


def main() -> None:
    """Write all pages."""
    (REFERENCE / "library").mkdir(parents=True, exist_ok=True)
    for name, page in PAGES.items():
        (REFERENCE / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
