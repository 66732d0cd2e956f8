"""Names of files as text for people: a terminal obeys the control characters they may hold."""

import os
from pathlib import PurePath

from acquisition.remote_files import url_of


def on_one_line(text: object) -> str:
    """Return a text or the name of a file as one line, with what is not printable escaped."""
    shown = url_of(text) if isinstance(text, PurePath) else str(text)
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in shown)


def beginning_of(name: str, most_bytes: int) -> str:
    """Return as many first letters of the name of a file as its system stores in so many bytes."""
    beginning = name[:most_bytes]
    while len(os.fsencode(beginning)) > most_bytes:
        beginning = beginning[:-1]
    return beginning
