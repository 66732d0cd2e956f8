"""The pages on the public functions in docs/reference/library, from their docstrings.

Written by ``python -m scripts.make_reference``.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, is_dataclass
from typing import Any

import standoff


@dataclass(frozen=True, kw_only=True)
class _Group:
    """A page: what stands on it, in this order, as docs/library.md names it."""

    file: str
    title: str
    about: str
    names: tuple[str, ...]


_GROUPS = (
    _Group(
        file="bench",
        title="The bench",
        about="[Programs](../../programs.md), [capture sessions](../../capture-sessions.md), "
        "[focus](../../focus.md).",
        names=(
            "Bench",
            "preview_plan",
            "capture_session",
            "watch_focus",
            "find_focus",
            "find_cameras",
        ),
    ),
    _Group(
        file="sessions",
        title="Sessions",
        about="[Capture sessions](../../capture-sessions.md), [validation](../../validation.md).",
        names=(
            "Session",
            "verify_session",
            "import_photographs",
            "export_session",
            "list_sessions",
            "show_session",
            "exclude_capture",
            "include_capture",
            "correct_height",
            "set_aside_files",
            "add_note",
            "validate",
            "read_validation",
            "write_report",
        ),
    ),
    _Group(
        file="psf",
        title="Photographs and the PSF",
        about="[Photographs](../../photographs.md), [calibration](../../calibration.md).",
        names=(
            "example_photographs",
            "read_image",
            "reading",
            "calibrate_psf",
            "measure_edges",
            "compare_psfs",
            "psf_history",
            "read_psf",
            "write_psf",
            "write_edge_table",
            "GaussianPsf",
            "TabulatedPsf",
        ),
    ),
    _Group(
        file="camera",
        title="Noise, lens reports, geometry and studies",
        about="[Noise](../../noise.md), [lens reports](../../lens-report.md), "
        "[geometry](../../geometry.md), [planning a study](../../plan-study.md).",
        names=(
            "measure_noise",
            "write_noise",
            "read_noise",
            "read_correction",
            "measure_lens",
            "write_lens",
            "calibrate_geometry",
            "write_geometry",
            "read_geometry",
            "plan_study",
            "write_study",
            "read_study",
        ),
    ),
    _Group(
        file="simulation",
        title="Simulated photographs",
        about="[Zoom-out](../../theory-simulation.md), [general pose](../../theory-pose.md), "
        "[training pairs](../../sr-pairs.md).",
        names=(
            "simulate",
            "zoom_out",
            "simulate_pose",
            "CaptureOptions",
            "UncertaintyOptions",
            "SceneDepth",
            "read_depth",
            "read_homography",
            "write_homography",
            "training_pairs",
        ),
    ),
    _Group(
        file="comparison",
        title="What changed",
        about="[What changed](../../changes.md).",
        names=(
            "register",
            "alignment_hints",
            "RegistrationHints",
            "FeatureMatches",
            "find_changes",
            "DetectionLimitOptions",
            "read_changes",
            "find_changes_of_series",
            "read_changes_series",
            "read_time_line",
        ),
    ),
    _Group(
        file="detectability",
        title="Detectability and poses",
        about="[How far may the camera move?](../../detectability.md), "
        "[how sure a verdict is](../../how-sure.md).",
        names=(
            "d_prime_curves",
            "measure_curves",
            "write_curves",
            "read_curves",
            "DetectionTask",
            "CurveChoice",
            "pose_limits",
            "judge_homography",
            "judge_pose",
            "read_pose",
            "judge_poses",
            "read_pose_series",
            "PoseWatch",
        ),
    ),
    _Group(
        file="detectors",
        title="Detectors of changes",
        about="[Your own detector](../../evaluate.md), [what a detector is](../../detectors.md).",
        names=(
            "evaluate",
            "read_evaluation",
            "EvaluationTask",
            "Spot",
            "patch_of",
            "change_pairs",
            "ChangePairsTask",
            "read_change_pairs",
            "train_detector",
            "load_learned",
            "TrainingOptions",
        ),
    ),
    _Group(
        file="benchmark",
        title="The public benchmark",
        about="[The data](../../benchmark-data.md), [the scores](../../benchmark-scoring.md).",
        names=("make_benchmark", "score_benchmark", "read_scores"),
    ),
    _Group(
        file="calls",
        title="What calls share",
        about="[As a library](../../library.md).",
        names=("Progress", "SweepOptions", "ArgumentError"),
    ),
)

TYPES = tuple(
    name
    for name in dir(standoff)
    if name[0].isupper() and not any(name in group.names for group in _GROUPS)
)
"""What calls take and return: shown where it is made."""

GROUPS = (
    *_GROUPS,
    _Group(
        file="types",
        title="Types of arguments and results",
        about="[As a library](../../library.md).",
        names=TYPES,
    ),
)

_ALIASES = """
| in a signature | takes |
| --- | --- |
| `FilePath` | a path, as text or as `pathlib.Path` |
| `ImageLike` | an array linear in light, a photograph, a capture of a bench, or a path |
| `PsfLike` | a PSF, a calibration, or the path of one, also [of one's own](../../own-psf.md) |
| `CurveLike` | a curve, several, or the path of a curves.json |
| `NoiseLike` | the noise of a capture, a noise calibration, or the path of a noise.json |
| `Progress` | an object with the two methods of [`Progress`](calls.md#progress) |
"""
_WIDTH = 92
_OURS = ("standoff", "acquisition", "analysis", "calibration", "simulation", "hil_mocks")
_CONSTANT = re.compile(r" = (?P<name>_?[A-Z][A-Z_]+)$")
_SECTION = re.compile(r"^(?P<title>[A-Z]\w+)\n-+\n", re.MULTILINE)
_ITEM = re.compile(r"^(?P<head>\S.*)\n(?P<text>(?:(?: {4}.*)?(?:\n|$))*)", re.MULTILINE)


def library_pages(made: str) -> dict[str, Callable[[], str]]:
    """The pages by their path in the reference; ``made`` says what they are made from."""

    def page_of(group: _Group) -> Callable[[], str]:
        return lambda: _page(group, made)

    index = {"library/index.md": lambda: _index(made)}
    return index | {f"library/{group.file}.md": page_of(group) for group in GROUPS}


def _index(made: str) -> str:
    lines = [f"# Functions\n\n{made}"]
    lines += ["What `import standoff` gives; [As a library](../../library.md) shows how it goes"]
    lines += ["together. Examples run in a folder with the files that"]
    lines += ["`python -m scripts.example_files FOLDER` makes in a checkout: photographs of edges,"]
    lines += ["and photographs, sessions and calibrations of a small simulated bench."]
    for group in GROUPS:
        lines += [f"\n## [{group.title}]({group.file}.md)\n", "| | |", "| --- | --- |"]
        for name in group.names:
            first = _markdown((_docstring(name)).split("\n\n")[0].replace("\n", " "))
            lines.append(f"| [`{name}`]({group.file}.md#{_anchor(name)}) | {_cell(first)} |")
    return "\n".join([*lines, "\n## Types", _ALIASES.rstrip()]) + "\n"


def _page(group: _Group, made: str) -> str:
    parts = [f"# {group.title}\n\n{made}", f"See {group.about} Files of examples and types: "]
    parts[-1] += "[Functions](index.md)."
    for name in group.names:
        parts += ["", f"## {name}", "", *_entry(name)]
    return "\n".join(parts) + "\n"


def _entry(name: str) -> Iterator[str]:
    found: Any = getattr(standoff, name)
    yield from ("```python", _signature(name, found), "```", "")
    pieces = _SECTION.split(_docstring(name))
    yield _markdown(pieces[0].strip())
    for title, text in zip(pieces[1::2], pieces[2::2], strict=True):
        yield f"\n**{title}**\n"
        if title == "Examples":
            yield from ("```pycon", text.strip(), "```")
        else:
            yield from _items(text, is_typed=title in ("Returns", "Raises"))
    if inspect.isclass(found):
        yield from _members(found)


def _items(text: str, *, is_typed: bool) -> Iterator[str]:
    for item in _ITEM.finditer(text.strip("\n") + "\n"):
        about = " ".join(textwrap.dedent(item["text"]).split())
        head = item["head"].strip()
        names = head if is_typed and " " in head and "," not in head else _names(head)
        yield f"- {names}{': ' if about else ''}{_markdown(about)}"


def _names(head: str) -> str:
    return ", ".join(f"`{name.strip()}`" for name in head.split(","))


def _members(found: type) -> Iterator[str]:
    """Public methods and properties that have a docstring, inherited ones of ours as well."""
    told: dict[str, str] = {}
    for base in found.__mro__:
        if base.__module__.split(".")[0] not in _OURS:
            continue
        for name, member in vars(base).items():
            about = inspect.getdoc(member.fget if isinstance(member, property) else member)
            is_ours = isinstance(member, property) or inspect.isfunction(member)
            if is_ours and about and not name.startswith("_"):
                arguments = "" if isinstance(member, property) else _arguments(member)
                first = about.split("\n\n")[0].replace("\n", " ")
                told.setdefault(name, f"| `{name}{arguments}` | {_cell(_markdown(first))} |")
    if told:
        yield "\n| method or property | |\n| --- | --- |"
        yield from (told[name] for name in sorted(told))


def _arguments(function: Callable[..., Any]) -> str:
    names = [name for name in inspect.signature(function).parameters if name != "self"]
    return f"({', '.join(names)})"


def _signature(name: str, found: Any) -> str:  # noqa: ANN401 - a function or a class
    """As the source writes it: its annotations have names, what they stand for is long."""
    node = ast.parse(textwrap.dedent(inspect.getsource(found))).body[0]
    arguments, result = [], ""
    if isinstance(node, ast.FunctionDef):
        arguments, result = _written(node.args), f" -> {_text(node.returns)}"
        arguments += _taken_over(node)
    elif isinstance(node, ast.ClassDef):
        made = _constructor(found, node)
        if made is None:
            named = {_text(one.target): _field(one) for one in _fields(found)}
            arguments = [field for name, field in named.items() if not name.startswith("_")]
            arguments = ["*", *arguments] if arguments else []
        else:
            arguments = [one for one in _written(made.args) if one != "self"]
    arguments = _with_values(arguments, found)
    line = f"{name}({', '.join(arguments)}){result}"
    if len(line) <= _WIDTH:
        return line
    return "\n".join([f"{name}(", *(f"    {one}," for one in arguments), f"){result}"])


def _with_values(arguments: list[str], found: Any) -> list[str]:  # noqa: ANN401 - as above
    """Arguments with what the constants among their defaults stand for."""
    known = inspect.getmodule(found).__dict__
    return [
        _CONSTANT.sub(lambda constant: f" = {known[constant['name']]!r}", one) for one in arguments
    ]


def _taken_over(node: ast.FunctionDef) -> list[str]:
    """The keywords that a function has of another public one, instead of ``**how``."""
    own = {one.arg for one in (*node.args.args, *node.args.kwonlyargs)}
    found: list[str] = []
    for decorator in node.decorator_list:
        if isinstance(decorator, ast.Call) and _text(decorator.func) == "with_keywords_of":
            other = getattr(standoff, _text(decorator.args[0]))
            made = ast.parse(textwrap.dedent(inspect.getsource(other))).body[0]
            assert isinstance(made, ast.FunctionDef)
            keywords = zip(made.args.kwonlyargs, made.args.kw_defaults, strict=True)
            written = [_argument(one, default) for one, default in keywords if one.arg not in own]
            found += _with_values(written, other)
    return found


def _fields(found: type) -> Iterator[ast.AnnAssign]:
    """The fields of a class, after those of its bases."""
    for base in reversed(found.__mro__):
        if base.__module__.split(".")[0] in _OURS:
            node = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
            assert isinstance(node, ast.ClassDef), "a class"
            yield from (one for one in node.body if isinstance(one, ast.AnnAssign))


def _constructor(found: type, node: ast.ClassDef) -> ast.FunctionDef | None:
    for one in node.body:
        if isinstance(one, ast.FunctionDef) and one.name == "__init__":
            return one
    for base in found.__mro__[1:]:
        is_ours = base.__module__.split(".")[0] in ("standoff", "acquisition")
        if is_ours and "__init__" in vars(base) and not is_dataclass(base):
            source = textwrap.dedent(inspect.getsource(vars(base)["__init__"]))
            made = ast.parse(source).body[0]
            return made if isinstance(made, ast.FunctionDef) else None
    return None


def _written(given: ast.arguments) -> list[str]:
    positional = [*given.posonlyargs, *given.args]
    defaults: list[ast.expr | None] = [None] * (len(positional) - len(given.defaults))
    found = [
        _argument(argument, default)
        for argument, default in zip(positional, [*defaults, *given.defaults], strict=True)
    ]
    if given.kwonlyargs:
        found.append("*")
        found += [
            _argument(argument, default)
            for argument, default in zip(given.kwonlyargs, given.kw_defaults, strict=True)
        ]
    return found


def _argument(argument: ast.arg, default: ast.expr | None) -> str:
    if argument.annotation is None:
        return argument.arg
    shown = "" if default is None else f" = {_text(default)}"
    return f"{argument.arg}: {_text(argument.annotation)}{shown}"


def _field(one: ast.AnnAssign) -> str:
    shown = "" if one.value is None else f" = {_text(one.value)}"
    if isinstance(one.value, ast.Call):
        shown = " = ..."
    return f"{_text(one.target)}: {_text(one.annotation)}{shown}"


def _text(node: ast.expr | None) -> str:
    if node is None:
        return "None"
    text = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None
    return ast.unparse(node) if text is None else repr(text)


def _docstring(name: str) -> str:
    return inspect.getdoc(getattr(standoff, name)) or ""


def _markdown(text: str) -> str:
    return text.replace("``", "`")


def _anchor(name: str) -> str:
    return name.lower()


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
