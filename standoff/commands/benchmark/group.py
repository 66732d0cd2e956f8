"""The group of the benchmark's commands."""

from typer import Typer

from standoff.commands.benchmark.make import make

benchmark = Typer(
    name="benchmark", help="The public benchmark: make its data set."
)
benchmark.command("make")(make)
