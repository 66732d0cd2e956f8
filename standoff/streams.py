"""Standard output and error as they are: of any encoding, closed, cut off by a reader, or full.

Imports the standard library alone, as the command line does until it knows its command.
"""

import codecs
import errno
import os
import re
import sys
from io import TextIOWrapper
from typing import Any, TextIO

READABLE = "standoff-readable"
"""Name of the error handler that writes in ASCII what an encoding lacks; unknown letters become
escapes."""

STANDARD_OUTPUT = "standard output"

_LINES = {0x2500: "-", 0x2501: "-", 0x2502: "|", 0x2503: "|", 0x2550: "-", 0x2551: "|"}
_SPELT = {
    **{"±": "+/-", "−": "-", "–": "-", "—": "-", "×": "x", "·": ".", "…": "...", "•": "*"},
    **{"µ": "u", "μ": "u", "Δ": "Delta", "σ": "sigma", "ρ": "rho", "λ": "lambda", "π": "pi"},
    **{"χ": "chi", "φ": "phi", "θ": "theta", "α": "alpha", "β": "beta", "Σ": "Sigma"},
    **{"°": " deg", "′": "'", "″": '"', "‘": "'", "’": "'", "“": '"', "”": '"', "„": '"'},
    **{letter: f"^{digit}" for letter, digit in zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-", strict=True)},
    **{"½": "1/2", "¼": "1/4", "¾": "3/4"},
    **{"≤": "<=", "≥": ">=", "≈": "~", "≠": "!=", "∞": "inf", "√": "sqrt", "∈": "in"},
    **{"→": "->", "←": "<-", "↔": "<->", "↑": "^", "↓": "v", "⇒": "=>", "✓": "ok", "✗": "x"},
    **{"\u00a0": " ", "\u2009": " ", "\u202f": " ", "\u2010": "-", "\u2011": "-"},
}
_RAISED_AGAIN = re.compile(r"(?<=\^[0-9-])\^([0-9])")
_BOXES, _BLOCKS = range(0x2500, 0x2580), range(0x2580, 0x25A0)


def in_ascii(letter: str) -> str:
    """Return how a letter is written where the encoding lacks it."""
    if letter in _SPELT:
        return _SPELT[letter]
    if ord(letter) in _BOXES:
        return _LINES.get(ord(letter), "+")
    if ord(letter) in _BLOCKS:
        return "#"
    return letter.encode("ascii", "backslashreplace").decode("ascii")


def as_shown(text: str, encoding: str) -> str:
    """Return a text as a stream of an encoding shows it, for whoever must know its width."""
    return text.encode(encoding, READABLE).decode(encoding)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    shown = "".join(map(in_ascii, error.object[error.start : error.end]))
    return _RAISED_AGAIN.sub(r"\1", shown), error.end


codecs.register_error(READABLE, _replaced)


class StandardOutput(TextIOWrapper):
    """Standard output; what it refuses names `STANDARD_OUTPUT` as its file."""

    def write(self, text: str, /) -> int:
        """Write a text."""
        try:
            return super().write(text)
        except OSError as error:
            error.filename = STANDARD_OUTPUT
            raise

    def flush(self) -> None:
        """Write what waits."""
        try:
            super().flush()
        except OSError as error:
            error.filename = STANDARD_OUTPUT
            raise


class StandardError(TextIOWrapper):
    """Standard error: remarks that nobody can be told end no work."""

    def write(self, text: str, /) -> int:
        """Write a text, or nothing where it is refused."""
        try:
            return super().write(text)
        except OSError:
            abandon(self)
            return len(text)

    def flush(self) -> None:
        """Write what waits, or nothing where it is refused."""
        try:
            super().flush()
        except OSError:
            abandon(self)


def open_streams() -> None:
    """Let standard output and error print whatever their encoding lacks, and open closed ones.

    Without a standard stream the next file that is opened would take its number, and what is
    printed would go into that.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # it gets the lowest free number, which is this one
            os.set_inheritable(number, True)
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - for the process
    if sys.stdout is sys.__stdout__:  # none that a program around us has put in place
        sys.stdout = StandardOutput(**_taken(sys.stdout, 1))
    if sys.stderr is sys.__stderr__:
        sys.stderr = StandardError(**_taken(sys.stderr, 2))


def flush_output() -> str | None:
    """Print what waits to be printed; return why that is not possible, if so.

    Returns
    -------
    str or None
        Empty where whoever read the output, such as ``head``, has seen enough.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        return output_fault(error)
    return None


def output_fault(error: OSError) -> str:
    """Say why standard output is refused; nothing where its reader has gone."""
    abandon(sys.stdout)
    if error.errno == errno.EPIPE:
        return ""
    return f"cannot write to standard output: {error.strerror or error}"


def abandon(stream: TextIO) -> None:
    """Let what a stream still holds go nowhere, so that its end does not fail again."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
    except (OSError, ValueError):  # a stream without a file
        pass


def _taken(stream: TextIO | None, number: int) -> dict[str, Any]:
    """The bytes and the settings of a standard stream; what was closed goes nowhere."""
    if not isinstance(stream, TextIOWrapper):
        stream = open(number, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    return {
        "encoding": stream.encoding,
        "errors": READABLE,
        "line_buffering": stream.line_buffering,
        "write_through": stream.write_through,
        "buffer": stream.detach(),
    }
