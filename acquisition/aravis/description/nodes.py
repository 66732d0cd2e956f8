"""The nodes of a GenICam description, parsed as Aravis parses them, with bounds on everything.

References
----------
GenICam Standard, GenApi 2.1.1, EMVA, 2018: node types and their elements.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from acquisition.errors import DescriptionFault

LARGEST_BYTES = 16 << 20
"""Of a description as it is served, and unpacked. The largest of 90 real ones has 1.3 MB."""

MOST_ELEMENTS = 300_000
DEEPEST_ELEMENT = 64
"""Real descriptions are nested six deep; libxml2 ends at 256."""

LONGEST_NAME = 1024

NOT_REGISTERED = ("pVariable", "Constant", "Expression")
"""Elements whose ``Name`` is that of a variable in a formula."""

CONTAINERS = ("RegisterDescription", "Group")
SKIPPED = ("Extension",)
FORMULAS = ("SwissKnife", "IntSwissKnife")

_ENCODING = re.compile(rb"""^(?:\xef\xbb\xbf)?<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._-]+)""")
_NATIVE = ("utf-8", "us-ascii", "iso-8859-1")


class DescriptionError(ValueError):
    """A description that Aravis must not be given; the text goes on after "its description"."""

    def __init__(
        self, message: str, *, fault: DescriptionFault, nodes: tuple[str, ...] = ()
    ) -> None:
        super().__init__(message)
        self.fault: DescriptionFault = fault
        self.nodes = nodes


@dataclass(frozen=True, slots=True, kw_only=True)
class Property:
    """An element of a node that has no node below it: its tag, attributes and text."""

    tag: str
    attributes: dict[str, str]
    text: str


@dataclass(slots=True, kw_only=True)
class Node:
    """One node: its kind (``IntReg``, ``Enumeration`` ...) and what it consists of.

    ``evaluated_with`` names nodes that lie inside it, or that it lies in, and that are evaluated
    when it is.
    """

    name: str
    kind: str
    properties: list[Property] = field(default_factory=list)
    evaluated_with: list[str] = field(default_factory=list)

    def texts(self, *tags: str) -> Iterator[str]:
        """The texts of its elements with one of these tags."""
        return (item.text for item in self.properties if item.tag in tags)


def parse_nodes(data: bytes) -> dict[str, Node]:
    """Return the nodes of a description by their names, those without a name under one of ours.

    Of two nodes with one name, both are kept in one: which of them Aravis takes does not matter.

    Raises
    ------
    DescriptionError
        If it is not well-formed XML, has a document type or entities of its own, or is larger or
        nested deeper than any camera's.
    """
    if len(data) > LARGEST_BYTES:
        raise DescriptionError(
            f"has {len(data) >> 20} MiB; no camera's is as large", fault="too large"
        )
    return _Parser().parse(data)


class _Parser:
    """Builds nodes from what expat reports; a property is an element without a node in it."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self._elements = 0
        self._texts: list[list[str]] = []
        self._open: list[Node | Property | None] = []
        self._skipped_from: int | None = None

    def parse(self, data: bytes) -> dict[str, Node]:
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.buffer_text = True
        try:
            parser.Parse(_decoded(data), True)
        except DescriptionError:
            raise
        except (expat.ExpatError, ValueError, LookupError) as error:
            raise DescriptionError(f"is not well-formed XML ({error})", fault="not XML") from error
        return self.nodes

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._elements += 1
        depth = len(self._open)
        if self._elements > MOST_ELEMENTS or depth >= DEEPEST_ELEMENT:
            raise DescriptionError(
                "has more than "
                + (
                    f"{MOST_ELEMENTS} elements"
                    if self._elements > MOST_ELEMENTS
                    else f"{DEEPEST_ELEMENT} elements inside each other"
                ),
                fault="too large",
            )
        if depth == 0 and tag != "RegisterDescription":
            raise DescriptionError(
                f"is not a GenICam description, but {tag[:40]!r}", fault="not XML"
            )
        self._texts.append([])
        if tag in SKIPPED and self._skipped_from is None:
            self._skipped_from = depth
        self._open.append(self._opened(tag, attributes))

    def _opened(self, tag: str, attributes: dict[str, str]) -> Node | Property | None:
        if self._skipped_from is not None or tag in CONTAINERS:
            return None
        name = attributes.get("Name", "").strip()
        if len(name) > LONGEST_NAME:
            raise DescriptionError(f"has a name of {len(name)} letters", fault="too large")
        around = self._open[-1] if self._open else None
        parent = around if isinstance(around, Node) else None
        is_node = (name and tag not in NOT_REGISTERED) or tag in FORMULAS
        if not is_node:
            return Property(tag=tag, attributes=attributes, text="")
        if tag == "EnumEntry" or not name:
            name = f"{parent.name if parent else ''}.{name or self._elements}"
        node = self.nodes.setdefault(name, Node(name=name, kind=tag))
        if node.kind != tag:
            raise DescriptionError(
                f"has two nodes named {name}, of different kinds", fault="node", nodes=(name,)
            )
        if parent is not None:
            if tag == "StructEntry":
                node.evaluated_with.append(parent.name)
            elif tag in (*FORMULAS, "EnumEntry"):
                parent.evaluated_with.append(name)
        return node

    def _end(self, _tag: str) -> None:
        item, text = self._open.pop(), "".join(self._texts.pop())
        if self._skipped_from == len(self._open):
            self._skipped_from = None
        if isinstance(item, Property) and self._open:
            owner = self._open[-1]
            if isinstance(owner, Node):
                owner.properties.append(
                    Property(tag=item.tag, attributes=item.attributes, text=text.strip())
                )

    def _characters(self, text: str) -> None:
        if self._texts:
            self._texts[-1].append(text)

    def _refuse_doctype(self, *_: object) -> None:
        raise DescriptionError("has a document type, which may expand to anything", fault="not XML")


def _decoded(data: bytes) -> bytes | str:
    """What expat is to parse: a terminating zero byte ends the text, as it does for Aravis."""
    data = data.partition(b"\0")[0].rstrip()
    stated = _ENCODING.match(data)
    encoding = stated[1].decode("ascii").lower() if stated else "utf-8"
    if encoding in _NATIVE:
        return data
    ascii_bytes = bytes(range(128))
    if ascii_bytes.decode(encoding, "replace") != ascii_bytes.decode("ascii"):
        raise DescriptionError(f"is encoded as {encoding}, which is not read", fault="not XML")
    return data.decode(encoding)
