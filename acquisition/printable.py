"""Names of files as text for people: a terminal obeys the control characters they may hold."""

from pathlib import PurePath

from acquisition.remote_files import url_of


def on_one_line(text: object) -> str:
    """Return a text or the name of a file as one line, with what is not printable escaped."""
    shown = url_of(text) if isinstance(text, PurePath) else str(text)
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in shown)
