"""The commands of ``standoff benchmark``."""

from typer import Typer

from standoff import terminal
from standoff.commands.benchmark.score import score

benchmark = Typer(name="benchmark", help="The public benchmark: score programs on it.")
benchmark.command("score", cls=terminal.Command)(score)
