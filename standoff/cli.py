"""The command line: registers the commands and turns errors into exit statuses.

0 done, 1 a device or data error in one line, 2 wrong usage, 130 interrupted.
"""

import sys
from typing import Annotated

import typer

from standoff import __version__
from standoff.commands.calibrate import calibrate
from standoff.commands.demo import demo
from standoff.commands.report import report
from standoff.commands.sessions import capture, verify
from standoff.commands.simulate import simulate
from standoff.errors import REPORTED_ERRORS
from standoff.output import ERRORS

__all__ = ["app", "main"]

EXIT_REPORTED = 1
EXIT_INTERRUPTED = 130

app = typer.Typer(
    name="standoff",
    help=(
        "Calibrate a bench camera's PSF, simulate the scene from further away, and say how "
        "much a change of camera pose costs in change detection."
    ),
    no_args_is_help=True,
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
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Hold the options that stand before a command."""


for command in (demo, capture, verify, calibrate, simulate, report):
    app.command()(command)


def main() -> None:
    """Run the command line and exit."""
    try:
        app()
    except KeyboardInterrupt:
        ERRORS.print("interrupted", markup=False)
        sys.exit(EXIT_INTERRUPTED)
    except REPORTED_ERRORS as error:
        ERRORS.print(f"standoff: {error}", markup=False)
        sys.exit(EXIT_REPORTED)
