"""Names of files as text for people: a terminal obeys the control characters they may hold."""


def on_one_line(text: object) -> str:
    """Return a text or the name of a file as one line, with what is not printable escaped."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in str(text))
