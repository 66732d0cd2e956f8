"""Print the locked lines of some extras, for pip: what a container holds beside the core.

    python -m scripts.locked_extras console aravis

requirements/full.txt has every extra and the developers' tools; these are its lines that the extras
named ask for, by what each line says it is there for. PyGObject, of the extra aravis, is built with
them and comes after them, from requirements/gobject.txt.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterable

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts.requirements_file import FOLDER, Locked, read


def locked_extras(extras: Iterable[str]) -> list[Locked]:
    """The lines that the extras need beside the core; KeyError if there is no such extra."""
    table = tomllib.loads((FOLDER.parent / "pyproject.toml").read_text("utf-8"))
    asked = table["project"]["optional-dependencies"]
    wanted = {canonicalize_name(Requirement(one).name) for name in extras for one in asked[name]}
    lines = read("full")
    while more := {line.name for line in lines if _asking(line) & wanted} - wanted:
        wanted |= more
    return [line for line in lines if line.name in wanted]


def _asking(line: Locked) -> set[str]:
    return {canonicalize_name(name.strip()) for name in line.via.split(",")}


def main() -> int:
    """Print the lines; 2 if an extra is unknown."""
    try:
        lines = locked_extras(sys.argv[1:])
    except KeyError as error:
        print(f"no extra is called {error}", file=sys.stderr)
        return 2
    print("".join(line.text() for line in lines), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
