"""Results as notebooks show them: a short line, a table, a picture inline."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from html import escape
from numbers import Real
from pathlib import PurePath

import numpy as np

_LONGEST_LINE = 160
_LONGEST_CELL = 90
_LISTED_MOST = 4


def html_table(caption: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as HTML, its texts escaped."""
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><caption>{escape(caption)}</caption><tr>{head}</tr>{body}</table>"


class Shown:
    """A result that prints as one short line, and in a notebook as a table of its fields."""

    __slots__ = ()

    def __repr__(self) -> str:
        told = "; ".join(f"{name} {text}" for name, text in _told_fields(self))
        return f"<{type(self).__name__}: {shortened(told, _LONGEST_LINE)}>"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        return html_table(type(self).__name__, ("", "value"), _told_fields(self))


def _told_fields(result: object) -> Iterator[tuple[str, str]]:
    """Yield the fields of a dataclass or of a document, and what they say in a few words."""
    kind, names = type(result), list[str]()
    stored = getattr(kind, "model_fields", None)
    if stored is not None:
        names = [name for name in stored if name not in ("schema_name", "provenance")]
    elif is_dataclass(kind):
        names = [one.name for one in fields(kind) if not one.name.startswith("_")]
    for name in names:
        text = in_words(getattr(result, name))
        if text:
            yield name.replace("_", " "), text


def in_words(value: object) -> str:
    """Return a value in a few words; nothing of what is None or empty."""
    if value is None:
        return ""
    if isinstance(value, np.ndarray):
        return f"{' x '.join(map(str, value.shape))} {value.dtype}"
    if isinstance(value, bool | str | int | PurePath | Enum):
        return shortened(" ".join(str(value).split()), _LONGEST_CELL)
    if isinstance(value, Real):
        return f"{float(value):.6g}"
    if isinstance(value, Mapping):
        return shortened(", ".join(map(str, value)), _LONGEST_CELL)
    if isinstance(value, list | tuple):
        is_short = len(value) <= _LISTED_MOST and all(isinstance(one, Real | str) for one in value)
        return (
            shortened(", ".join(map(in_words, value)), _LONGEST_CELL)
            if is_short
            else f"{len(value)} of them"
        )
    return shortened(" ".join(repr(value).split()), _LONGEST_CELL)


def shortened(text: str, most: int) -> str:
    """Return a text, cut where it is longer."""
    return text if len(text) <= most else f"{text[: most - 2]} …"
