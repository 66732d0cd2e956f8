"""Every option and argument of a command that names a file or folder, found in the application."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typer.main import get_command

from standoff.terminal import application
from standoff.terminal._app import path_parameters
from tests.fuzz.commands.slots import SLOTS

LINES = {
    "demo": "demo --out out",
    "paper": "paper --short --out out",
    "capture": "capture --bench @bench.toml --plan @plan.toml --out out --yes",
    "focus": "focus --bench @bench.toml --sweep --from 180 --to 200",
    "change-pairs": "change-pairs @photographs --psf @psf.json --zooms 1,2 --noise 1,2 --out out",
    "plan-study": "plan-study --bench @bench.toml --plan @plan.toml --psf @psf.json",
    "evaluate": "evaluate ssim --photographs @photographs --psf @psf.json --noise 2 "
    "--contrast 12 --out evaluation.json",
    "report": "report @series --out out.html",
    "console": "console --bench @bench.toml",
    "guide": "guide @photographs/1.tif --host 127.0.0.1 --port 0",
    "mock": "mock",
    "session include": "session include 0 @taken",
    "session set-height": "session set-height 0 @imported --height-mm 200 --reason wrong",
    "session set-aside": "session set-aside @taken --reason dust",
    "benchmark make": "benchmark make --size tiny --out out",
    "noise --dark": "noise --dark @frames.tif --flat @frames.tif --out out.json",
    "lens --dark": "lens @edge.tif --dark @frames.tif --flat @frames.tif --out out.html",
    "lens --flat": "lens @edge.tif --dark @frames.tif --flat @frames.tif --out out.html",
    "noise --flat": "noise --dark @frames.tif --flat @frames.tif --out out.json",
}
"""A sound command line of each command of which the search for odd files has none that does.

Some are of one option, which excludes others.
``@name`` is a sound file.
"""

_SOUND_FOLDERS = {"answers", "board", "edges", "imported", "lens", "noisy", "photographs", "series"}
_SOUND_FOLDERS |= {"taken", "benchmark"}
_NAMES_A_FILE = re.compile(r"\.(?:json|pt)\b")
_ENDINGS = {
    "csv": ".csv",
    "nearer": ".png",
    "picture": ".png",
    "plot": ".svg",
    "report": ".html",
    "uncertainty": ".tif",
    "bench": ".toml",
}
"""Of options that no sound line has; a wrong ending would be what is refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathOption:
    """One place of a command line where a path belongs.

    Parameters
    ----------
    command, name
        As they are typed: ``session show`` and ``--out``; of an argument its name.
    before, after
        The words of a sound command line around the path.
    ending
        Of the names of files that belong there.
    is_text
        Whether something else may stand there as well: a number, say.
    """

    command: str
    name: str
    before: tuple[str, ...]
    after: tuple[str, ...]
    ending: str
    is_text: bool

    def words(self, path: str, sound: Path) -> list[str]:
        """The command line with a path, and the folder of sound files."""
        words = [*self.before, path, *self.after]
        return [f"{sound}/{word[1:]}" if word[:1] == "@" else word for word in words]

    def __str__(self) -> str:
        return f"{self.command} {self.name}"


def each_command() -> Iterator[tuple[str, Any]]:
    """The name and definition of each command, those of groups with the group's name."""
    for name, command in get_command(application([])).commands.items():  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        if inner is None:
            yield name, command
        else:
            yield from ((f"{name} {other}", one) for other, one in inner.items())


def path_options() -> list[PathOption]:
    """Those of every command; a command without a sound line is an error."""
    return [
        _option(name, command, parameter)
        for name, command in each_command()
        for parameter in _named_files(command)
    ]


def _named_files(command: Any) -> Iterator[Any]:
    """Parameters that are paths, or texts that may name a file, as their help says."""
    paths = list(path_parameters(command))
    yield from paths
    for parameter in command.params:
        kind = parameter.type_descriptor.annotation
        if parameter not in paths and kind is str and _NAMES_A_FILE.search(parameter.help or ""):
            yield parameter


def _option(name: str, command: Any, parameter: Any) -> PathOption:
    word = parameter.opts[0]
    line = line_of(f"{name} {word}" if f"{name} {word}" in LINES else name)
    head = len(name.split())
    if word.startswith("-"):
        at = line.index(word) + 1 if word in line else len(line) + 1
        line = line if word in line else [*line, word, ""]
    else:
        at = _place_of(parameter, command, line[head:]) + head
        line = line if at < len(line) else [*line, ""]
    is_text = parameter.type_descriptor.annotation is str
    ending = "".join(Path(line[at]).suffixes) or _ENDINGS.get(parameter.name, "")
    if is_text:
        ending = _NAMES_A_FILE.findall(parameter.help)[0]
    return PathOption(
        command=name,
        name=word,
        before=tuple(line[:at]),
        after=tuple(line[at + 1 :]),
        ending=ending,
        is_text=is_text,
    )


def line_of(name: str) -> list[str]:
    if name in LINES:
        return LINES[name].split()
    slots = (slot for slot in SLOTS if " ".join(slot.arguments).startswith(f"{name} "))
    slot = next(slots, None)
    assert slot is not None, f"{name} has no sound command line: add one to LINES"
    head, rest = slot.arguments[: len(name.split())], slot.arguments[len(name.split()) :]
    sound = [f"@{slot.file}" if word == "BAD" else word for word in rest]
    return [*head, *(f"@{word}" if word in _SOUND_FOLDERS else word for word in sound)]


def _place_of(parameter: Any, command: Any, words: list[str]) -> int:
    """Where an argument stands among the words of a command, or would follow them."""
    flags = {
        one: getattr(other, "is_flag", False) for other in command.params for one in other.opts
    }
    places, at = [], 0
    while at < len(words):
        if words[at].startswith("--"):
            at += 1 if flags[words[at]] else 2
        else:
            places.append(at)
            at += 1
    arguments = [one for one in command.params if not one.opts[0].startswith("-")]
    number = arguments.index(parameter)
    if any(one.nargs == -1 for one in arguments[:number]):
        number -= len(arguments)  # counted from the end, behind the list
    return places[number] if number < len(places) else len(words)
