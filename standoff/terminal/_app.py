"""The application: its commands, how their command lines are read, and how errors end them.

0 done, 1 a device or data error in one line, 2 wrong usage, 130 interrupted, 143 SIGTERM.
"""

import os
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from difflib import get_close_matches
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, get_args

import typer
from typer import BadParameter
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException
from typer.main import get_command

from acquisition.files import refusal_text, require_reachable
from acquisition.quantities import decimal_comma_remedy
from standoff import __version__
from standoff.errors import REPORTED_ERRORS, ArgumentError
from standoff.library import called_as
from standoff.streams import STANDARD_OUTPUT, output_fault
from standoff.terminal._output import NOTED, print_text, say_error
from standoff.terminal._words import examples_text, meant_command

EXIT_REPORTED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130

COMMANDS = {
    "demo": "validation:demo",
    "capture": "capture:capture",
    "session": "sessions:session",
    "verify": "sessions:verify",
    "import": "sessions:import_photographs",
    "export": "sessions:export",
    "calibrate": "calibrate:calibrate",
    "compare": "calibrate:compare",
    "focus": "bench:focus",
    "geometry": "geometry:geometry",
    "noise": "noise:noise",
    "lens": "lens:lens",
    "simulate": "simulate:simulate",
    "sr-pairs": "training_pairs:sr_pairs",
    "change-pairs": "training_pairs:change_pairs",
    "plan-study": "capture:plan_study",
    "detectability": "detectability:detectability",
    "evaluate": "evaluate:evaluate",
    "limits": "pose:limits",
    "pose": "pose:pose",
    "changes": "changes:changes",
    "validate": "validation:validate",
    "paper": "validation:paper",
    "report": "sessions:report",
    "benchmark": "benchmark:benchmark",
    "console": "console:console",
    "guide": "guide:guide",
    "mock": "mock:mock",
    "doctor": "bench:doctor",
    "cameras": "bench:cameras",
    "stage": "bench:stage",
}
"""Module and function of each command in standoff.commands, in the order of the help."""

_SHARED_OUT = {"--workers", "--scheduler", "--shard"}
_TOLD = {"--json", "--strict", "--force"}

_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("_ARGUMENTS", default=())


class _Group(TyperGroup):
    """Commands, one of which is named to whoever asks for it by another word of the field."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - typer's own
        """Return the command that is named; wrong usage with the one that is meant if none is."""
        word = args[0]
        if self.get_command(ctx, word) is None and not word.startswith("-"):
            meant = meant_command(word, ctx.info_name, self.commands)
            remedy = f"; {ctx.command_path} --help lists the commands."
            if meant is not None:
                named = self.get_command(ctx, meant.partition(" ")[0])
                purpose = "" if named is None else f" {named.get_short_help_str(limit=200)}"
                remedy = f". Did you mean {meant!r}?{purpose}"
            ctx.fail(f"No such command {word!r}{remedy}")
        return super().resolve_command(ctx, args)


_LIKE = 0.7
"""How alike an option and an argument are that mean one thing, as a plural is."""


class _Command(TyperCommand):
    """A command whose help names what a list is made of: ``<path>``, not ``<list[Path]>``.

    A path that nothing can be at is refused as wrong usage, one that the system refuses as an error
    of the data. Of a list the command decides: one photograph need not end the work on the others.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - typer's own
        super().__init__(*args, **kwargs)
        for parameter in self.params:
            descriptor = getattr(parameter, "type_descriptor", None)
            if descriptor is None:
                continue
            # A file that may not be read is no wrong usage: whoever reads it says so.
            descriptor.parameter_info.readable = False
            if descriptor.is_list and not descriptor.is_choice:
                [part] = get_args(descriptor.annotation)
                shown = partial(_constant, f"<{part.__name__.lower()}>")
                is_argument = parameter.nargs != 1  # shown by its type besides its name
                if is_argument or parameter.metavar is None:
                    vars(parameter).update(display_type=shown, display_type_rich=shown)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - typer's own
        """Parse the command line, and check its paths."""
        given, _, _ = self.make_parser(ctx).parse_args(args=list(args))
        for parameter in path_parameters(self):
            for text in _texts(given.get(parameter.name)):
                if not text or "\0" in text:
                    fault = "it holds a zero byte" if text else "it is empty"
                    raise BadParameter(
                        f"not a valid name of a file or folder: {fault}", ctx=ctx, param=parameter
                    )
        try:
            rest = super().parse_args(ctx, args)
        except BadParameter as error:
            # What is missing has no message of its own; what it is for says where to get it.
            error.message = error.message or getattr(error.param, "help", None) or ""
            raise
        for parameter in path_parameters(self):
            path = ctx.params.get(parameter.name)
            if isinstance(path, Path) and given.get(parameter.name) is not None:
                require_reachable(path)
        return rest


def _option_named(command: Any, arguments: Sequence[str], argument: str | None) -> str | None:  # noqa: ANN401 - typer's own
    """The option of a command line for an argument as Python spells it; None if none is.

    ``min_d_prime`` is ``--min-dprime``; the command line begins with the names of the command.
    """
    for word in arguments:
        command = getattr(command, "commands", {}).get(word, command)
    if argument is None:
        return None
    options = {_letters(name): name for one in command.params for name in one.opts}
    words = argument.split("_")
    shorter = ["".join(words[:count]) for count in range(len(words), 0, -1)]  # without its unit
    near = [one for one in shorter if one in options]
    near += get_close_matches(shorter[0], options, n=1, cutoff=_LIKE)
    if not near:
        return None
    option = str(options[near[0]])
    return option if option.startswith("-") else option.upper()


def _letters(name: str) -> str:
    return name.replace("-", "").replace("_", "")


def path_parameters(command: TyperCommand) -> Iterator[Any]:
    """Yield the options and arguments of a command whose values are paths, or lists of them."""
    for parameter in command.params:
        descriptor = getattr(parameter, "type_descriptor", None)
        if descriptor is not None and Path in (
            descriptor.annotation,
            *get_args(descriptor.annotation),
        ):
            yield parameter


def _texts(value: str | Sequence[str] | None) -> Sequence[str]:
    """What the command line gives for a parameter, which may be repeated."""
    return () if value is None else (value,) if isinstance(value, str) else value


def _constant(text: str, ctx: object) -> str:
    return text


def application(arguments: list[str]) -> typer.Typer:
    """Return the application for a command line, with the command that it names.

    Only that command is imported. If the first argument names no command, as for the help or a
    misspelt name, all of them are.
    """
    app = typer.Typer(
        name="standoff",
        help=(
            "Measure the sharpness of a lens and camera (PSF, MTF and SFR), simulate the scene "
            "from further away, align photographs and find the difference between them, and say "
            "how much a change of camera pose costs in change detection."
        ),
        cls=_Group,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_show_help)
    for name in _needed(arguments):
        command = _imported(COMMANDS[name])
        if isinstance(command, typer.Typer):
            for one in command.registered_commands:
                one.cls = _Command
            app.add_typer(command, cls=_Group, epilog=examples_text(name))
        else:
            app.command(name, cls=_Command, epilog=examples_text(name))(command)
    return app


def _needed(arguments: list[str]) -> list[str]:
    first = arguments[:1]
    if first == ["--version"]:
        return []
    return [name for name in first if name in COMMANDS] or list(COMMANDS)


def _imported(path: str) -> Any:  # noqa: ANN401 - a function, or a group of them
    module, name = path.split(":")
    return getattr(import_module(f"standoff.commands.{module}"), name)


def _show_version(wanted: bool) -> None:
    if wanted:
        print_text(f"standoff {__version__}")
        raise typer.Exit


def _show_help(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Show the help if no command is given."""
    if context.invoked_subcommand is None:
        print_text(context.get_help())
        raise typer.Exit(EXIT_USAGE)


def run_application(app: typer.Typer, arguments: list[str]) -> int:
    """Run one command line and return its exit status; errors are one line on stderr."""
    try:
        with _invocation(arguments):
            status = app(arguments, standalone_mode=False, prog_name="standoff")
    except TyperException as error:
        said = f"{error.format_message()}{_decimal_comma(error)}"
        say_error(" ".join(said.split()))
        return EXIT_USAGE
    except ArgumentError as error:
        option = _option_named(get_command(app), arguments, error.argument)
        say_error(error if option is None else f"Invalid value for {option}: {error.reason}")
        return EXIT_USAGE
    except REPORTED_ERRORS as error:
        say_error(error)
        return EXIT_REPORTED
    except OSError as error:
        fault = _refusal(error)
        if fault:
            say_error(fault)
        return EXIT_REPORTED
    except (typer.Abort, KeyboardInterrupt):
        status = EXIT_INTERRUPTED
    if status == EXIT_INTERRUPTED:
        say_error("interrupted; run the same command again")
    return status or 0


def _refusal(error: OSError) -> str:
    """What the system refused, of which no part of the command has told."""
    if error.filename == STANDARD_OUTPUT:
        return output_fault(error)
    if isinstance(error.filename, str | bytes):
        return refusal_text(Path(os.fsdecode(error.filename)), error)
    if isinstance(error, FileNotFoundError) and not _has_folder():
        return "the folder in which the command runs has been removed; change to another"
    return error.strerror or str(error) or type(error).__name__


def _has_folder() -> bool:
    try:
        Path.cwd()
    except OSError:
        return False
    return True


def _decimal_comma(error: TyperException) -> str:
    """What to write for a number with a decimal comma, if that is what was refused."""
    from pydantic import ValidationError

    if not isinstance(error.__cause__, ValidationError):
        return ""
    given = error.__cause__.errors()[0]["input"]
    remedy = decimal_comma_remedy(given) if isinstance(given, str) else None
    return f"; {remedy}" if remedy else ""


@contextmanager
def _invocation(arguments: Sequence[str]) -> Iterator[None]:
    """Remember a command, and what it has noted, while it runs."""
    token, noted = _ARGUMENTS.set(tuple(arguments)), NOTED.set([])
    try:
        with called_as(_command_line()):
            yield
    finally:
        _ARGUMENTS.reset(token)
        NOTED.reset(noted)


def _command_line() -> str:
    """Return the command that runs, quoted for a POSIX shell."""
    return shlex.join(("standoff", *_ARGUMENTS.get()))


def is_same_command(line: str | None) -> bool:
    """Whether a command line of before, if there is one, asks for what the command that runs does.

    How the work is shared out and told does not count.
    """
    return line is not None and _asked(line) == _asked(_command_line())


def _asked(line: str) -> list[str]:
    asked, words = [], iter(shlex.split(line))
    for word in words:
        if word in _SHARED_OUT:
            next(words, None)
        elif word not in _TOLD and word.partition("=")[0] not in _SHARED_OUT:
            asked.append(word)
    return asked
