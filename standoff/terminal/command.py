"""A command: the help of its lists, and its paths, which are checked before it does anything."""

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, get_args

from typer import BadParameter
from typer.core import TyperCommand, TyperGroup

from acquisition.files import require_reachable
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


_LIKE = 0.7
"""How alike an option and an argument are that mean one thing, as a plural is."""


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


def option_named(command: Any, arguments: Sequence[str], argument: str | None) -> str | None:  # noqa: ANN401 - typer's own
    """The option of a command line for an argument of the function behind it; None if none is.

    Parameters
    ----------
    command
        The application.
    arguments
        The command line, which begins with the names of the command.
    argument
        As Python spells it: ``min_d_prime`` is ``--min-dprime``.
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
