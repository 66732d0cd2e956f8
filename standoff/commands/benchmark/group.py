"""The group of the benchmark's commands."""

from typer import Typer

from standoff import terminal
from standoff.commands.benchmark.make import make
from standoff.commands.benchmark.score import score

benchmark = Typer(
    name="benchmark", help="The public benchmark: make its data set, score programs on it."
)
benchmark.command("make", cls=terminal.Command)(make)
benchmark.command("score", cls=terminal.Command)(score)
