"""Strategies for damaged input: bytes, JSON documents and TOML text that were sound once."""

import json
from copy import deepcopy
from typing import Any

from hypothesis import strategies as st

DEEP = "[" * 5_000
"""Brackets beyond the depth of any parser that calls itself."""

ODD_VALUES: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    10**400,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "\0",
    "\ud800",
    [],
    {},
    [[]],
    {"schema": 1},
)

scalars = st.one_of(
    st.sampled_from(ODD_VALUES),
    st.integers(),
    st.floats(),
    st.text(max_size=20),
)
json_values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


@st.composite
def damaged_bytes(draw: st.DrawFn, samples: tuple[bytes, ...]) -> bytes:
    """Change, cut, repeat or insert bytes in one of the samples, or draw some altogether."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.binary(max_size=200))
    content = bytearray(draw(st.sampled_from(samples)))
    for _ in range(draw(st.integers(0, 4))):
        first = draw(st.integers(0, len(content)))
        last = min(len(content), first + draw(st.integers(0, 16)))
        match draw(st.sampled_from(["change", "cut", "repeat", "insert", "end"])):
            case "change":
                content[first:last] = draw(st.binary(min_size=last - first, max_size=last - first))
            case "cut":
                del content[first:last]
            case "repeat":
                content[first:first] = content[first:last]
            case "insert":
                content[first:first] = draw(st.binary(max_size=16))
            case "end":
                del content[first:]
    return bytes(content)


def places(document: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all values in a JSON document."""
    inner: list[tuple[Any, ...]] = [here]
    if isinstance(document, dict):
        for key, value in document.items():
            inner += places(value, (*here, key))
    elif isinstance(document, list):
        for place, value in enumerate(document):
            inner += places(value, (*here, place))
    return inner


@st.composite
def damaged_documents(draw: st.DrawFn, document: dict[str, Any]) -> dict[str, Any]:
    """Replace, remove or add a few values anywhere in a JSON document."""
    found = deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(places(found)[1:] or [("schema",)]))
        parent = found
        for key in path[:-1]:
            parent = parent[key]
        match draw(st.sampled_from(["replace", "remove", "add"])):
            case "remove" if path[-1] in parent or isinstance(parent, list):
                del parent[path[-1]]
            case "add" if isinstance(parent, dict):
                parent[draw(st.text(max_size=8))] = deepcopy(
                    draw(json_values)
                )  # drawn values may be shared
            case _:
                parent[path[-1]] = deepcopy(draw(json_values))  # drawn values may be shared
    return found


def damaged_json(document: dict[str, Any]) -> st.SearchStrategy[bytes]:
    """Text of a JSON document with damaged values, damaged bytes or brackets without end."""
    sound = json.dumps(document).encode()
    return st.one_of(
        # Surrogates cannot be encoded, so that what is written is ASCII.
        damaged_documents(document).map(lambda found: json.dumps(found).encode()),
        damaged_bytes((sound,)),
        st.sampled_from([DEEP.encode(), sound[:-1] + b',"a":' + DEEP.encode(), b"\xef\xbb\xbf{}"]),
    )


TOML_VALUES = (
    *("true", "-1", "nan", "inf", "1e400", "''", "'x'", "[]", "{}", "[[1]]", "[nan, 1]"),
    *("1979-05-27", "0x7fffffffffffffffffff", "9" * 5000, "{ start = 1 }", "'\\u0000'", "'''"),
    DEEP,
)


@st.composite
def damaged_toml(draw: st.DrawFn, sample: bytes) -> bytes:
    """Give a few keys of TOML text other values; or damage bytes."""
    if draw(st.booleans()):
        return draw(damaged_bytes((sample,)))
    lines = sample.decode().splitlines()
    keys = [place for place, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(keys))
        lines[place] = lines[place].partition("=")[0] + "= " + draw(st.sampled_from(TOML_VALUES))
    return "\n".join(lines).encode()
