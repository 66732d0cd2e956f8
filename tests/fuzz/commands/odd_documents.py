"""Damaged JSON, TOML, tables and journals, made from the sound file that they take the place of."""

import json
import re
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from acquisition.session._journal import (
    HEAD_NAME,
    NO_LINES,
    ChainedLine,
    JournalHead,
    chain_after,
)
from tests.fuzz.commands.odd_file import OddFile, cut_short, made_of, of_bytes, with_flipped_bits
from tests.fuzz.damage import DEEP, places

CASES_LEAST = 200

_NUMBER = "@number@"
_LITERALS = ("NaN", "Infinity", "-Infinity", "1e400", "9" * 5000, "-" + "9" * 400, "1e-400", "-0.0")
_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 0.5, 1e300, 3e38, -1e300, 1e-300, 2**63, 2**31, "", "text", "\0"),
    *("\ud800", "\x1b[2J\x07", "../../etc/passwd", "/dev/zero", "x" * 100_000),
    *([], {}, [[]], {"schema": 1}, [0] * 1000, ["a"], [None], [1e300], [-1.0, 2.0]),
)


def odd_json(sound: bytes) -> Iterator[OddFile]:
    """Cases for a JSON document."""
    yield from _texts("JSON", sound)
    document = json.loads(sound)
    for name, value in (("number", 7), ("list", []), ("null", None), ("text", "a"), ("object", {})):
        data = json.dumps(value).encode()
        yield of_bytes("JSON of another type", name, data, is_refused=True)
    for name, text in (("NaN", "NaN"), ("two documents", "{}{}"), ("comment", "{} // a")):
        yield of_bytes("no JSON", name, text.encode(), is_refused=True)
    yield of_bytes(
        "JSON of another schema",
        "version 999",
        json.dumps(document | {"schema": "standoff.other/999"}).encode(),
    )
    twice = sound.rstrip()[:-1] + b", " + sound.lstrip()[1:]
    yield of_bytes("JSON with keys given twice", "all", twice)
    yield of_bytes("JSON with an unknown key", "all", json.dumps(document | {"more": 1}).encode())
    for kind, name, changed in _values(document, most=3 * CASES_LEAST):
        yield made_of(f"JSON {kind}", name, changed)


def odd_journal(sound: bytes) -> Iterator[OddFile]:
    """Cases for a journal: events on a line each, in a chain that is broken or made anew."""
    # A last line that is none was cut short by a power cut.
    yield from _texts("journal", sound, is_refused=False)
    lines = sound.splitlines(keepends=True)
    for index in range(len(lines)):
        cut = lines[index][: len(lines[index]) // 2] + b"\n"
        torn = b"".join([*lines[:index], cut, *lines[index + 1 :]])
        yield of_bytes("journal with half a line", f"line {index + 1}", torn)
    yield of_bytes("journal without line ends", "all", sound.replace(b"\n", b" "))
    yield of_bytes("journal of a million empty lines", "all", b"\n" * 1_000_000)
    for kind, name, changed in _rearranged(lines):
        yield of_bytes(kind, name, b"".join(changed))
    texts = [_text_of(line) for line in lines]
    for kind, name, changed in _rearranged(texts):
        numbered = [_numbered(text, place) for place, text in enumerate(changed, start=1)]
        chained = partial(_write_chained, numbered)
        yield OddFile(kind=f"chained {kind}", name=name, make=chained, is_chained_anew=True)
    for index in sorted({0, 1, len(texts) // 2, len(texts) - 1}):
        for kind, name, event in _values(json.loads(texts[index]), most=60):
            chained = partial(_chain_with, event, texts, index)
            yield OddFile(
                kind=f"chained event {kind}",
                name=f"line {index + 1}: {name}",
                make=chained,
                is_chained_anew=True,
            )
        for kind, name, event in _values(json.loads(lines[index]), most=15):
            altered = partial(_lines_with, event, lines, index)
            yield made_of(f"event {kind}", f"line {index + 1}: {name}", altered)


def _lines_with(event: Callable[[], bytes], lines: list[bytes], index: int) -> bytes:
    return b"".join([*lines[:index], event() + b"\n", *lines[index + 1 :]])


def _chain_with(event: Callable[[], bytes], texts: list[bytes], index: int, path: Path) -> None:
    _write_chained([*texts[:index], event(), *texts[index + 1 :]], path)


def _rearranged(lines: list[bytes]) -> Iterator[tuple[str, str, list[bytes]]]:
    """Kind, name and lines of a journal with a line too few, too many, or in the wrong place."""
    for index in range(len(lines)):
        name = f"line {index + 1}"
        yield "journal without a line", name, lines[:index] + lines[index + 1 :]
        yield "journal with a line twice", name, [*lines[: index + 1], *lines[index:]]
    yield "journal in another order", "reversed", lines[::-1]


def _text_of(line: bytes) -> bytes:
    link = ChainedLine.parse(line)
    assert link is not None
    return link.text


def _numbered(text: bytes, number: int) -> bytes:
    return re.sub(rb'^\{"seq": \d+', b'{"seq": %d' % number, text)


def _write_chained(texts: list[bytes], path: Path) -> None:
    """Write a journal of these lines as if it had been written so, with its head."""
    chain, written = NO_LINES, b""
    for text in texts:
        chain = chain_after(chain, text)
        written += ChainedLine(text=text, chain=chain).to_bytes()
    path.write_bytes(written)
    head = JournalHead(lines=len(texts), chain=chain)
    path.with_name(HEAD_NAME).write_bytes(head.to_bytes())


def odd_toml(sound: bytes) -> Iterator[OddFile]:
    """Cases for a TOML file."""
    yield from _texts("TOML", sound)
    text = sound.decode()
    lines = text.splitlines()
    yield of_bytes(
        "TOML with keys given twice", "all", (text + "\n" + text).encode(), is_refused=True
    )
    yield of_bytes(
        "TOML with an unknown table", "at the end", (text + "\n[more]\na = 1\n").encode()
    )
    values = (
        *("nan", "inf", "-inf", "1e400", "1e300", "3e38", "-1", "0", "0.5", "true", "''", "'x'"),
        *("[]", "{}", "[[1]]", "[nan, 1]", "1979-05-27", "0x7fffffffffffffffffff", "9" * 5000),
        *("'\\u001b[2J'", '"\\u001b[2J"', '"\\u0000"', "'../../etc'", "[1e300, 2e300]", "'''"),
        *("'/dev/zero'", "1_000_000_000_000", "[0, 0]", "", "= 1"),
    )
    keys = [place for place, line in enumerate(lines) if re.match(r"\w+ *=", line)]
    for place in keys:
        gone = "\n".join(lines[:place] + lines[place + 1 :])
        yield of_bytes("TOML without a key", lines[place], gone.encode())
    for value in values:
        for place in keys:
            key = lines[place].partition("=")[0]
            changed = "\n".join([*lines[:place], f"{key}= {value}", *lines[place + 1 :]])
            yield of_bytes("TOML of another value", f"{key}= {value[:30]}", changed.encode())


def odd_table(sound: bytes) -> Iterator[OddFile]:
    """Cases for a table of comma-separated values."""
    yield from _texts("table", sound)
    head, *rows = sound.decode().splitlines()
    values = (
        "",
        "nan",
        "inf",
        "1e300",
        "-3e38",
        "text",
        '"',
        '"a\nb"',
        "1,2",
        "\x1b[2J",
        "9" * 5000,
    )
    for value in values:
        for row in range(len(rows)):
            cells = rows[row].split(",")
            for column in range(len(cells)):
                changed = ",".join([*cells[:column], value, *cells[column + 1 :]])
                text = "\n".join([head, *rows[:row], changed, *rows[row + 1 :]])
                name = f"row {row}, column {column}: {value[:20]!r}"
                yield of_bytes("table of another value", name, text.encode("utf-8"))
    for name, text in (
        ("head alone", head),
        ("one row", "\n".join([head, rows[0]])),
        ("the same rows", "\n".join([head, *rows[:1] * 9])),
        ("semicolons", sound.decode().replace(",", ";")),
        ("a million rows", "\n".join([head, *rows[:1] * 1_000_000])),
    ):
        yield of_bytes("table of too little or too much", name, text.encode())


def at_least(cases: Callable[[bytes], Iterator[OddFile]], sound: bytes) -> Iterator[OddFile]:
    """The cases for a sound file, and draws of wrong bits until there are enough."""
    found = 0
    for case in cases(sound):
        found += 1
        yield case
    yield from with_flipped_bits("file", "more", sound, max(0, CASES_LEAST - found))


def _texts(kind: str, sound: bytes, *, is_refused: bool = True) -> Iterator[OddFile]:
    """Text that is no such text, or too much of it."""
    yield from cut_short(kind, kind, sound, 12)
    yield from with_flipped_bits(kind, kind, sound, 24)
    for name, data in (
        ("UTF-16", sound.decode().encode("utf-16")),
        ("Latin-1", b"\xe9\xff" + sound),
        ("with zeros", b"\0".join(sound[i : i + 1] for i in range(len(sound)))),
        ("binary", Random(1).randbytes(4096)),
        ("brackets without end", DEEP.encode()),
        ("a million brackets", b"[" * 1_000_000),
        ("objects without end", b'{"a":' * 100_000),
        ("escapes", b"\x1b[2J\x1b]0;owned\x07" * 9),
        ("a long line", b"a" * 5_000_000),
        ("one long text", b'"' + b"a" * 5_000_000 + b'"'),
        ("40 MB of spaces", b" " * 40_000_000),
        ("30 MB of lists", b"[" + b"[]," * 10_000_000 + b"[]]"),
        ("60 MB of numbers", b"[" + b"1," * 30_000_000 + b"1]"),
    ):
        yield of_bytes(f"no {kind}", name, data, is_refused=is_refused)
    yield of_bytes(f"{kind} with a byte order mark", "UTF-8", b"\xef\xbb\xbf" + sound)


def _values(document: Any, most: int) -> Iterator[tuple[str, str, Callable[[], bytes]]]:
    """Each value in a document removed, or another one in its place; in the order of a draw.

    Kind, name and text of at most ``most`` of each of the two; the text is made when it is needed.
    """
    paths = places(document)[1:]
    texts = [*_LITERALS, *(json.dumps(value) for value in _VALUES)]
    changes = [(path, text) for path in paths for text in texts]
    random = Random(1)
    random.shuffle(changes)
    for path in random.sample(paths, min(most, len(paths))):
        yield "without a value", _dotted(path), partial(_without, document, path)
    for number, (path, text) in enumerate(changes[:most]):
        name = f"{number}: {_dotted(path)} = {text[:30]}"
        yield "of another value", name, partial(_with_value, document, path, text)


def _without(document: Any, path: tuple[Any, ...]) -> bytes:
    changed = deepcopy(document)
    del _parent(changed, path)[path[-1]]
    return json.dumps(changed).encode()


def _with_value(document: Any, path: tuple[Any, ...], text: str) -> bytes:
    changed = deepcopy(document)
    _parent(changed, path)[path[-1]] = _NUMBER
    return json.dumps(changed).replace(json.dumps(_NUMBER), text).encode()


def _parent(document: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        document = document[key]
    return document


def _dotted(path: tuple[Any, ...]) -> str:
    return ".".join(map(str, path))
