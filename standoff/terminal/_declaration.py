"""How a command is declared: a function whose parameters are its options, and rules on them.

Parameters that stand before ``*`` are arguments, the others options; the help of each stands in the
function's docstring, under ``Options``. What every command does with its options follows from that:
what does not go together is refused, results that would overwrite something are refused before any
work, options that belong together become one value, and those that the library's function takes by
the same name reach it without being named again.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from copy import copy
from dataclasses import dataclass
from functools import wraps
from os.path import lexists, realpath
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from typer import Argument, BadParameter, Context, Option
from typer.models import ParameterInfo

from acquisition.files import PAGES, require_place, require_reachable
from acquisition.remote_files import is_url, url_of
from standoff import library
from standoff.errors import ApplicationError
from standoff.terminal._output import ShownProgress, note_once, print_json

Json = Annotated[bool, Option("--json", help="Print one JSON document on stdout and nothing else.")]
Force = Annotated[bool, Option("--force", help="Replace existing results.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Running:
    """The command that runs: as it was parsed, which options are results, and its values."""

    context: Context
    results: Collection[str]
    values: dict[str, Any]


_RUNNING: ContextVar[_Running] = ContextVar("_RUNNING")


_HELP = re.compile(r"^(\w+): (.+(?:\n +.+)*)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class MadeBy:
    """Marks a parameter whose value a function makes of several options: its own parameters."""

    function: Callable[..., object]


class Result:
    """Marks an option that names a file to write, which ends in one of ``suffixes``.

    It is refused where it would overwrite something, unless ``is_resumed``: then the command
    decides what may be replaced.
    """

    def __init__(self, *suffixes: str, is_resumed: bool = False) -> None:
        self.suffixes = suffixes
        self.is_resumed = is_resumed


REPORT = Result(*PAGES)


@dataclass(frozen=True, slots=True)
class Given:
    """An option or argument of a command, named by its parameter.

    It is given if its value is one of ``values``; without any, if it is not the default.
    """

    name: str
    values: tuple[object, ...] = ()

    def is_given(self, context: Context) -> bool:
        """Whether the command line gives it."""
        value = context.params[self.name]
        if self.values:
            return value in self.values
        defaults = {one.name: one.default for one in context.command.params}
        return value not in (None, False, (), defaults[self.name])

    def text(self, context: Context) -> str:
        """Its name as in the help, with ``values``."""
        word = _word(context, self.name)
        values = " or ".join(str(value) for value in self.values)
        return f"{word} {values}".rstrip() if word.startswith("-") else word


@dataclass(frozen=True, slots=True, kw_only=True)
class OptionRule:
    """A rule for a command line; ``because`` is added to the message about a fault.

    It does not hold where ``unless`` is given.
    """

    kind: Literal["needs", "excludes", "exactly one"]
    options: tuple[Given, ...]
    because: str = ""
    unless: Given | None = None

    def fault(self, context: Context) -> str | None:
        """Say in a sentence how a command line breaks the rule; None if it does not."""
        if self.unless is not None and self.unless.is_given(context):
            return None
        first, *others = self.options
        given = [option for option in self.options if option.is_given(context)]
        if self.kind == "exactly one":
            if len(given) == 1:
                return None
            said = f"give exactly one of {_listed(self.options, context, 'and')}"
        elif self.kind == "needs":
            if first not in given or len(given) > 1:
                return None
            said = f"{first.text(context)} needs {_listed(others, context, 'or')}"
        else:
            if first not in given or len(given) == 1:
                return None
            said = f"{first.text(context)} cannot be used with {_listed(given[1:], context, 'or')}"
        return f"{said}: {self.because}" if self.because else said


def needs(option: str | Given, *others: str | Given, because: str = "") -> OptionRule:
    """Refuse an option unless at least one of ``others`` is given."""
    return OptionRule(kind="needs", options=_options(option, *others), because=because)


def excludes(option: str | Given, *others: str | Given, because: str = "") -> OptionRule:
    """Refuse an option together with any of ``others``."""
    return OptionRule(kind="excludes", options=_options(option, *others), because=because)


def exactly_one(*options: str | Given, unless: str | None = None) -> OptionRule:
    """Refuse a command line that does not give exactly one of ``options``."""
    return OptionRule(
        kind="exactly one",
        options=_options(*options),
        unless=None if unless is None else Given(unless),
    )


def _options(*options: str | Given) -> tuple[Given, ...]:
    return tuple(Given(one) if isinstance(one, str) else one for one in options)


def _listed(options: Sequence[Given], context: Context, word: str) -> str:
    *first, last = [option.text(context) for option in options]
    return f"{', '.join(first)} {word} {last}" if first else last


def _word(context: Context, name: str) -> str:
    """The name of an option, or of an argument in capitals as the help writes it."""
    word = next(str(one.opts[0]) for one in context.command.params if one.name == name)
    return word if word.startswith("-") else word.upper()


def command(
    *rules: OptionRule, has_json: bool = True, suffixes_last: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a command by a function. What it writes and prints gives it --force and --json.

    A parameter that `MadeBy` marks stands for the options of which its value is made. What is at
    the place of a result is looked at once the names' suffixes are right, or before.
    """

    def declared(function: Callable[..., None]) -> Callable[..., None]:
        own = _parameters(function)
        made = {name: one for name in own for one in _marks(own[name], MadeBy)}
        results = {name: one for name in own for one in _marks(own[name], Result)}
        options = list(_flattened(own))
        added = [("force", Force)] if any(not one.is_resumed for one in results.values()) else []
        added += [("json", Json)] if has_json else []
        options += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
            for name, kind in added
            if name not in own
        ]
        named = {option.name for rule in rules for option in rule.options}
        unknown = named - {one.name for one in options}
        assert not unknown, f"{function.__name__} has no {unknown}"

        @wraps(function)
        def called(context: Context, **values: Any) -> None:  # noqa: ANN401 - of any option
            _RUNNING.set(_Running(context=context, results=results, values=values))
            for rule in rules:
                fault = rule.fault(context)
                if fault is not None:
                    raise BadParameter(fault)
            _refuse_results(context, results, suffixes_last=suffixes_last)
            for name, one in made.items():
                parts = inspect.signature(one.function).parameters
                values[name] = one.function(**{part: values.pop(part) for part in parts})
            function(**{name: values[name] for name in own})

        first = inspect.Parameter(
            "context", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=Context
        )
        called.__doc__ = (inspect.getdoc(function) or "").partition("\n\nOptions\n")[0]
        vars(called)["__signature__"] = inspect.Signature([first, *options])
        called.__annotations__ = {one.name: one.annotation for one in [first, *options]}
        return called

    return declared


def _parameters(function: Callable[..., object]) -> dict[str, inspect.Parameter]:
    """The parameters of a function, each with the help that the docstring has for it."""
    helps, found = dict(_HELP.findall(inspect.getdoc(function) or "")), {}
    for name, one in inspect.signature(function).parameters.items():
        hint = one.annotation
        if isinstance(hint, str):  # what the function returns is not looked at: it imports a lot
            hint = eval(hint, function.__globals__)  # noqa: S307 - our own
        marks = list(hint.__metadata__) if get_origin(hint) is Annotated else []
        kind = get_args(hint)[0] if marks else hint
        if not any(isinstance(mark, MadeBy) for mark in marks):
            is_argument = one.kind is not inspect.Parameter.KEYWORD_ONLY
            infos = [mark for mark in marks if isinstance(mark, ParameterInfo)]
            info = copy(infos[0]) if infos else Argument() if is_argument else Option()
            info.help = " ".join(helps[name].split()) if name in helps else info.help
            info.show_default = info.show_default and one.default is not one.empty
            hint = Annotated[(kind, info, *(mark for mark in marks if mark not in infos))]
        found[name] = one.replace(annotation=hint)
    return found


def _flattened(own: Mapping[str, inspect.Parameter]) -> Iterator[inspect.Parameter]:
    for parameter in own.values():
        marks = _marks(parameter, MadeBy)
        if marks:
            yield from _flattened(_parameters(marks[0].function))
        else:
            yield parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)


def _marks(parameter: inspect.Parameter, kind: type[Any]) -> list[Any]:
    hint = parameter.annotation
    inside = get_args(hint) if get_origin(hint) is Annotated else ()
    return [one for one in inside if isinstance(one, kind)]


def _refuse_results(
    context: Context, results: Mapping[str, Result], *, suffixes_last: bool
) -> None:
    paths = {name: context.params[name] for name in results}
    new = [paths[name] for name, result in results.items() if not result.is_resumed]

    def refuse_suffixes() -> None:
        for name, result in results.items():
            _refuse_suffix(paths[name], _word(context, name), result.suffixes)

    def refuse_what_is_there() -> None:
        if any(path is not None for path in new):
            _refuse_overwriting(new, _inputs(), force=context.params["force"])

    checks = [refuse_suffixes, refuse_what_is_there]
    for check in reversed(checks) if suffixes_last else checks:
        check()
    library.require_writable(new)


def refuse_replacing(*files: Path, may_replace: bool = False) -> None:
    """Refuse, before any work, to write files that the command that runs reads, or are there.

    Those that are there may be replaced with --force, or if ``may_replace``.
    """
    force = may_replace or _RUNNING.get().context.params["force"]
    _refuse_overwriting(files, _inputs(), force=force)


def _inputs() -> list[Path]:
    """Every path of the command line that is no result."""
    running = _RUNNING.get()
    found: list[Path] = []
    for name, value in running.context.params.items():
        if name not in running.results and name != "out":
            several = value if isinstance(value, list | tuple) else (value,)
            found += [one for one in several if isinstance(one, Path)]
    return found


def keywords_of(function: Callable[..., object], **others: object) -> dict[str, Any]:
    """What the command line says of the keywords of a function, which have the names of options.

    ``others`` are values that come before those of the command line.
    """
    values = {"progress": ShownProgress(), **_RUNNING.get().values, **others}
    taken = inspect.signature(function).parameters.values()
    return {
        one.name: values[one.name]
        for one in taken
        if one.kind is inspect.Parameter.KEYWORD_ONLY and one.name in values
    }


def wants_json() -> bool:
    """Whether the command that runs prints one JSON document and nothing else."""
    return bool(_RUNNING.get().context.params["json"])


def answer(document: object, show: Callable[[], None], notes: Iterable[str] = ()) -> None:
    """Print what a command found: for people, or with --json as one document.

    The document is lists, numbers and text, the model of a file, or a function that returns them.
    Of the notes on it, those that were printed meanwhile are not printed again.
    """
    note_once(notes)
    if wants_json():
        print_json(document() if callable(document) else document)
    else:
        show()


def _refuse_overwriting(
    outputs: Sequence[Path | None], inputs: Sequence[Path | None] = (), *, force: bool
) -> None:
    """Refuse, before any work, results that would overwrite something; None is not asked for.

    A result that is an input or another result is wrong usage; one that is there already, unless
    ``force``, or that cannot be put there, is an error of the data.
    """
    # Path.resolve raises where symbolic links form a loop; the reader names that better.
    taken = {realpath(path) for path in inputs if path is not None}
    results = [path for path in outputs if path is not None]
    for path in results:
        if realpath(path) in taken:
            raise BadParameter(f"{path} is already an input or output; name another file")
        taken.add(realpath(path))
    for path in results:
        require_reachable(path)
        if is_url(path):
            from acquisition.files import is_there

            if not force and is_there(path):
                raise ApplicationError(
                    f"{url_of(path)} exists already; --force replaces it, or name another"
                )
            continue
        from acquisition.session import refuse_capture  # with what reads sessions

        try:
            refuse_capture(path)
        except OSError as error:
            raise ApplicationError(f"cannot write {path}: {error.strerror}") from error
        if path.is_dir():
            raise ApplicationError(f"cannot write {path}: it is a folder")
        if path.exists() and not path.is_file():
            raise ApplicationError(f"cannot write {path}: it is not a regular file")
        if lexists(path) and not force:
            raise ApplicationError(
                f"{path} exists already; --force replaces it, or name another file"
            )
        require_place(path)


def _refuse_suffix(path: Path | None, option: str, suffixes: Collection[str]) -> None:
    """Refuse a file name whose suffix does not match the format that is written."""
    if path is not None and path.suffix.lower() not in suffixes:
        names = " or ".join(sorted(suffixes))
        raise BadParameter(f"{path} must end in {names}", param_hint=option)
