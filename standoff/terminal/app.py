"""The application: registers the commands and turns errors into exit statuses.

0 done, 1 a device or data error in one line, 2 wrong usage, 130 interrupted, 143 SIGTERM.
"""

import os
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException
from typer.main import get_command

from acquisition.files import refusal_text
from acquisition.quantities import decimal_comma_remedy
from standoff import __version__
from standoff.errors import REPORTED_ERRORS, ArgumentError
from standoff.streams import STANDARD_OUTPUT, output_fault
from standoff.terminal.command import Command, Group, option_named
from standoff.terminal.command_help import examples_text
from standoff.terminal.invocation import invocation
from standoff.terminal.output import print_text, say_error

EXIT_REPORTED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130

COMMANDS = {
    "demo": "rehearsals:demo",
    "capture": "capture:capture",
    "session": "sessions:session",
    "verify": "sessions:verify",
    "import": "photographs:import_photographs",
    "export": "export:export",
    "calibrate": "calibrate:calibrate",
    "compare": "compare:compare",
    "focus": "focus:focus",
    "geometry": "geometry:geometry",
    "noise": "noise:noise",
    "simulate": "simulate:simulate",
    "sr-pairs": "training_pairs:sr_pairs",
    "change-pairs": "training_pairs:change_pairs",
    "plan-study": "plan_study:plan_study",
    "detectability": "detectability:detectability",
    "evaluate": "evaluate:evaluate",
    "limits": "limits:limits",
    "pose": "pose:pose",
    "changes": "changes:changes",
    "validate": "validate:validate",
    "paper": "rehearsals:paper",
    "report": "report:report",
    "benchmark": "benchmark:benchmark",
    "console": "console:console",
    "mock": "mock:mock",
    "doctor": "doctor:doctor",
    "cameras": "doctor:cameras",
    "stage": "stage:stage",
}
"""Module and function of each command in standoff.commands, in the order of the help."""


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
        cls=Group,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_show_help)
    for name in _needed(arguments):
        command = _imported(COMMANDS[name])
        if isinstance(command, typer.Typer):
            for one in command.registered_commands:
                one.cls = Command
            app.add_typer(command, cls=Group, epilog=examples_text(name))
        else:
            app.command(name, cls=Command, epilog=examples_text(name))(command)
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
        with invocation(arguments):
            status = app(arguments, standalone_mode=False, prog_name="standoff")
    except TyperException as error:
        said = f"{error.format_message()}{_decimal_comma(error)}"
        say_error(" ".join(said.split()))
        return EXIT_USAGE
    except ArgumentError as error:
        option = option_named(get_command(app), arguments, error.argument)
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
