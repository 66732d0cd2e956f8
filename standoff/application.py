"""The application: registers the commands and turns errors into exit statuses.

0 done, 1 a device or data error in one line, 2 wrong usage, 130 interrupted.
"""

from typing import Annotated

import typer
from typer.exceptions import TyperException

from standoff import __version__
from standoff.commands.calibrate import calibrate
from standoff.commands.capture import capture
from standoff.commands.changes import changes
from standoff.commands.compare import compare
from standoff.commands.console import console
from standoff.commands.demo import demo
from standoff.commands.detectability import detectability
from standoff.commands.doctor import cameras, doctor
from standoff.commands.focus import focus
from standoff.commands.geometry import geometry
from standoff.commands.limits import limits
from standoff.commands.mock import mock
from standoff.commands.noise import noise
from standoff.commands.paper import paper
from standoff.commands.photographs import import_photographs
from standoff.commands.pose import pose
from standoff.commands.report import report
from standoff.commands.sessions import session, verify
from standoff.commands.simulate import simulate
from standoff.commands.sr_pairs import sr_pairs
from standoff.commands.stage import stage
from standoff.commands.validate import validate
from standoff.errors import REPORTED_ERRORS
from standoff.output import ERRORS

__all__ = ["app", "run"]

EXIT_REPORTED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130

app = typer.Typer(
    name="standoff",
    help=(
        "Calibrate a bench camera's PSF, simulate the scene from further away, and say how "
        "much a change of camera pose costs in change detection."
    ),
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"standoff {__version__}")
        raise typer.Exit


@app.callback()
def standoff(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Show the help where no command is given."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(EXIT_USAGE)


for command in (
    demo,
    capture,
    verify,
    calibrate,
    compare,
    focus,
    geometry,
    noise,
    simulate,
    sr_pairs,
    detectability,
    limits,
    pose,
    changes,
    validate,
    paper,
    report,
    console,
    mock,
    doctor,
    cameras,
    stage,
):
    app.command(command.__name__.replace("_", "-"))(command)
app.command("import")(import_photographs)
app.add_typer(session)


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit status; errors are one line on stderr."""
    try:
        status = app(arguments, standalone_mode=False, prog_name="standoff")
    except TyperException as error:
        ERRORS.print(f"standoff: {' '.join(error.format_message().split())}", markup=False)
        return EXIT_USAGE
    except REPORTED_ERRORS as error:
        ERRORS.print(f"standoff: {error}", markup=False)
        return EXIT_REPORTED
    except (typer.Abort, KeyboardInterrupt):
        status = EXIT_INTERRUPTED
    if status == EXIT_INTERRUPTED:
        ERRORS.print("standoff: interrupted; run the same command again", markup=False)
    return status or 0
