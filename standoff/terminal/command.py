"""A command: the help of its lists, and its paths, which are checked before it does anything."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

from typer import BadParameter
from typer.core import TyperCommand, TyperGroup

from standoff.library.files import require_reachable
from standoff.terminal.field_words import meant_command


class Group(TyperGroup):
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


class Command(TyperCommand):
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
                        f"no name of a file or folder: {fault}", ctx=ctx, param=parameter
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
