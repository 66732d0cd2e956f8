"""Whether a GenICam description can be given to Aravis, which trusts every word of it.

What is refused ends the process inside Aravis, or keeps it busy for ever, when the feature
concerned is evaluated; found with Aravis 0.8.26, whose later versions up to 0.8.35 do the same.
The nodes are parsed as Aravis parses them, with bounds on everything.

Aravis evaluates a node by calling itself for each node that this one needs. It does not notice a
circle, but fills the stack, and the process dies. What a node needs for its value is in
`_EVALUATED`. ``pMin``, ``pMax``, ``pInc``, ``pIsImplemented``, ``pIsAvailable`` and ``pIsLocked``
are asked for beside the value, never for it: a width whose maximum depends on an offset, whose
maximum depends on the width, is no circle of evaluation. ``pSelected``, ``pInvalidator`` and
``pFeature`` are not followed at all.

References
----------
GenICam Standard, GenApi 2.1.1, EMVA, 2018: node types and their elements.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from xml.parsers import expat

from acquisition.aravis._formulas import (
    ANYTHING,
    LONGEST_FORMULA,
    NOTHING,
    SAFE_BITS,
    TRUTH,
    Extent,
    OverflowingDivisionError,
    either,
    extent_of_number,
    formula_extent,
)
from acquisition.errors import CameraDescriptionError, DescriptionFault
from acquisition.printable import on_one_line

LARGEST_BYTES = 16 << 20
"""Of a description as it is served, and unpacked. The largest of 90 real ones has 1.3 MB."""

MOST_ELEMENTS = 300_000
DEEPEST_ELEMENT = 64
"""Real descriptions are nested six deep; libxml2 ends at 256."""

_LONGEST_NAME = 1024

_NOT_REGISTERED = ("pVariable", "Constant", "Expression")
"""Elements whose ``Name`` is that of a variable in a formula."""

_CONTAINERS = ("RegisterDescription", "Group")
_SKIPPED = ("Extension",)
_FORMULAS = ("SwissKnife", "IntSwissKnife")

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
class _Property:
    """An element of a node that has no node below it: its tag, attributes and text."""

    tag: str
    attributes: dict[str, str]
    text: str


@dataclass(slots=True, kw_only=True)
class _Node:
    """One node: its kind (``IntReg``, ``Enumeration`` ...), content, and the nodes inside it."""

    name: str
    kind: str
    properties: list[_Property] = field(default_factory=list)
    evaluated_with: list[str] = field(default_factory=list)

    def texts(self, *tags: str) -> Iterator[str]:
        """The texts of its elements with one of these tags."""
        return (item.text for item in self.properties if item.tag in tags)


def _parse_nodes(data: bytes) -> dict[str, _Node]:
    """Return the nodes by their names; of two with one name, both are kept in one."""
    if len(data) > LARGEST_BYTES:
        raise DescriptionError(
            f"has {len(data) >> 20} MiB; no camera's is as large", fault="too large"
        )
    return _Parser().parse(data)


class _Parser:
    """Builds nodes from what expat reports; a property is an element without a node in it."""

    def __init__(self) -> None:
        self.nodes: dict[str, _Node] = {}
        self._elements = 0
        self._texts: list[list[str]] = []
        self._open: list[_Node | _Property | None] = []
        self._skipped_from: int | None = None

    def parse(self, data: bytes) -> dict[str, _Node]:
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
        if tag in _SKIPPED and self._skipped_from is None:
            self._skipped_from = depth
        self._open.append(self._opened(tag, attributes))

    def _opened(self, tag: str, attributes: dict[str, str]) -> _Node | _Property | None:
        if self._skipped_from is not None or tag in _CONTAINERS:
            return None
        name = attributes.get("Name", "").strip()
        if len(name) > _LONGEST_NAME:
            raise DescriptionError(f"has a name of {len(name)} letters", fault="too large")
        around = self._open[-1] if self._open else None
        parent = around if isinstance(around, _Node) else None
        is_node = (name and tag not in _NOT_REGISTERED) or tag in _FORMULAS
        if not is_node:
            return _Property(tag=tag, attributes=attributes, text="")
        if tag == "EnumEntry" or not name:
            name = f"{parent.name if parent else ''}.{name or self._elements}"
        node = self.nodes.setdefault(name, _Node(name=name, kind=tag))
        if node.kind != tag:
            raise DescriptionError(
                f"has two nodes named {name}, of different kinds", fault="node", nodes=(name,)
            )
        if parent is not None:
            if tag == "StructEntry":
                node.evaluated_with.append(parent.name)
            elif tag in (*_FORMULAS, "EnumEntry"):
                parent.evaluated_with.append(name)
        return node

    def _end(self, _tag: str) -> None:
        item, text = self._open.pop(), "".join(self._texts.pop())
        if self._skipped_from == len(self._open):
            self._skipped_from = None
        if isinstance(item, _Property) and self._open:
            owner = self._open[-1]
            if isinstance(owner, _Node):
                owner.properties.append(
                    _Property(tag=item.tag, attributes=item.attributes, text=text.strip())
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


_EVALUATED = (
    "pValue",
    "pValueIndexed",
    "pValueDefault",
    "pVariable",
    "pAddress",
    "pLength",
    "pIndex",
)
_OFFSET = "pOffset"
"""Attribute of a ``pIndex``; evaluated, too."""

_NEEDED = (*_EVALUATED, "pPort", "pMin", "pMax", "pInc", "pCommandValue")
"""References to a node that does not exist; Aravis takes them for 0."""

LONGEST_CHAIN = 200
"""Nodes that need each other in a row. Real cameras have up to 20; 100 000 fill the stack."""

MOST_EVALUATIONS = 20_000
"""For one value: nodes count as often as they are evaluated. Real cameras have up to 442."""

_ADDED_BY_ARAVIS = ("GevSCPSPacketSize", "GevSCPD", "TLParamsLocked")
_PREFIX_OF_ARAVIS = "ArvGev"
"""Nodes that Aravis adds itself where the camera has none of the name."""

_NAMES_SHOWN = 6


def _evaluated_names(node: _Node) -> Iterator[str]:
    """Names of the nodes that are evaluated for the value of this one."""
    yield from node.evaluated_with
    for item in node.properties:
        if item.tag in _EVALUATED:
            yield item.text
        if _OFFSET in item.attributes:
            yield item.attributes[_OFFSET].strip()


def _evaluation_order(nodes: Mapping[str, _Node]) -> tuple[str, ...]:
    """Names of all nodes, each after those that it is evaluated from."""
    graph = {
        name: [needed for needed in _evaluated_names(node) if needed in nodes]
        for name, node in nodes.items()
    }
    try:
        return tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        around = tuple(reversed(error.args[1]))  # as they refer to each other
        raise DescriptionError(
            f"refers to itself ({_shown(around)})", fault="circle", nodes=around
        ) from error


def _require_complete(nodes: Mapping[str, _Node]) -> None:
    """Refuse references to nodes that do not exist, and nodes in place of Aravis' own."""
    for node in nodes.values():
        if node.name.startswith(_PREFIX_OF_ARAVIS):
            raise DescriptionError(
                f"has a node {node.name}, which is Aravis' own", fault="node", nodes=(node.name,)
            )
        for tag, name in _needed(node):
            is_added = name in _ADDED_BY_ARAVIS or name.startswith(_PREFIX_OF_ARAVIS)
            if name not in nodes and not is_added:
                raise DescriptionError(
                    f"refers to a node that it does not have ({node.name}: {tag} {name[:60]!r})",
                    fault="missing node",
                    nodes=(node.name, name),
                )


def _require_short_chains(nodes: Mapping[str, _Node], order: tuple[str, ...]) -> None:
    """Refuse chains of references, in evaluation order, that fill the stack or take for ever."""
    lengths: dict[str, int] = {}
    evaluations: dict[str, int] = {}
    for name in order:
        needed = [other for other in _evaluated_names(nodes[name]) if other in nodes]
        lengths[name] = 1 + max((lengths[other] for other in needed), default=0)
        evaluations[name] = 1 + sum(evaluations[other] for other in needed)
        if lengths[name] > LONGEST_CHAIN:
            raise DescriptionError(
                f"has a chain of more than {LONGEST_CHAIN} nodes that need each other, to {name}",
                fault="too large",
                nodes=(name,),
            )
        if evaluations[name] > MOST_EVALUATIONS:
            raise DescriptionError(
                f"asks for more than {MOST_EVALUATIONS} evaluations for one value, of {name}",
                fault="too large",
                nodes=(name,),
            )


def _needed(node: _Node) -> Iterator[tuple[str, str]]:
    for item in node.properties:
        if item.tag in _NEEDED:
            yield item.tag, item.text
        if _OFFSET in item.attributes:
            yield _OFFSET, item.attributes[_OFFSET].strip()


def _shown(names: tuple[str, ...]) -> str:
    if len(names) > _NAMES_SHOWN:
        half = _NAMES_SHOWN // 2
        names = (*names[:half], f"{len(names) - _NAMES_SHOWN} more", *names[-half:])
    return " -> ".join(name[:60] for name in names)


LONGEST_REGISTER_BYTES = 1 << 20
"""Aravis takes as much memory as a register is long, and ends the process if it gets none."""

_NUMBERS = ("IntReg", "MaskedIntReg", "FloatReg", "StructReg")
"""Registers that are numbers: the length of the standard's others may come from another node."""

_REGISTERS = (*_NUMBERS, "StringReg", "Register")
_WRITTEN_BITS = 53
"""Of a node without a register, which keeps what was written to it."""

_REMEDY = (
    "its firmware is damaged or not the maker's: reinstall the maker's firmware, or use "
    "another camera"
)

_CHUNK_ID = "ChunkID"


@dataclass(frozen=True, slots=True, kw_only=True)
class SoundDescription:
    """What the driver asks of a description that was found sound.

    ``in_chunks`` are the registers that lie in what a frame carries beside its picture,
    ``of_open_length`` those whose length another node tells.
    """

    needed: Mapping[str, tuple[str, ...]]
    in_chunks: frozenset[str]
    of_open_length: frozenset[str]

    def nodes_of(self, feature: str) -> tuple[str, ...]:
        """Names of all nodes that a feature's value is evaluated from, its own among them."""
        found: dict[str, None] = {}
        waiting = [feature]
        while waiting:
            name = waiting.pop()
            if name not in found:
                found[name] = None
                waiting += self.needed.get(name, ())
        return tuple(found)


def require_sound_description(data: bytes, camera: str) -> SoundDescription:
    """Refuse an unpacked description that takes Aravis down; the error names the nodes at fault."""
    try:
        return _checked(data.partition(b"\0")[0])
    except DescriptionError as error:
        raise description_error(error, camera) from error


def description_error(error: DescriptionError, camera: str) -> CameraDescriptionError:
    """The error that a person reads, of this camera."""
    return CameraDescriptionError(
        on_one_line(f"the description of {camera} {error}; {_REMEDY}"),
        fault=error.fault,
        nodes=error.nodes,
    )


@lru_cache(maxsize=2)
def _checked(data: bytes) -> SoundDescription:
    """Check a description; that of a camera that is opened again is not checked again."""
    nodes = _parse_nodes(data)
    order = _evaluation_order(nodes)
    _require_short_chains(nodes, order)
    _require_complete(nodes)
    for node in nodes.values():
        _require_bounded_register(node)
    _require_safe_formulas(nodes, order)
    ports = {node.name for node in nodes.values() if any(node.texts(_CHUNK_ID))}
    return SoundDescription(
        needed={name: tuple(_evaluated_names(node)) for name, node in nodes.items()},
        in_chunks=frozenset(
            node.name for node in nodes.values() if not ports.isdisjoint(node.texts("pPort"))
        ),
        of_open_length=frozenset(
            node.name for node in nodes.values() if any(node.texts("pLength"))
        ),
    )


def _require_bounded_register(node: _Node) -> None:
    if node.kind not in _REGISTERS:
        return
    if node.kind in _NUMBERS and any(node.texts("pLength")):
        raise DescriptionError(
            f"does not state the length of the number in {node.name}",
            fault="register",
            nodes=(node.name,),
        )
    for text in node.texts("Length"):
        length = extent_of_number(text).literal
        if length is None or not 0 < length <= LONGEST_REGISTER_BYTES:
            raise DescriptionError(
                f"has a register of {text[:40] or 'no'} bytes ({node.name})",
                fault="register",
                nodes=(node.name,),
            )


def _require_safe_formulas(nodes: Mapping[str, _Node], order: tuple[str, ...]) -> None:
    extents: dict[str, Extent] = {}
    for name in order:
        node = nodes[name]
        try:
            extents[name] = _extent_of(node, nodes, extents)
        except OverflowingDivisionError as error:
            raise DescriptionError(
                f"has a formula that {error} ({name})", fault="formula", nodes=(name,)
            ) from error


def _extent_of(node: _Node, nodes: Mapping[str, _Node], extents: Mapping[str, Extent]) -> Extent:
    """How large the value of a node can be, from those that it is evaluated from."""
    if node.kind in ("IntReg", "MaskedIntReg"):
        return _register_extent(node)
    if node.kind == "StructEntry":
        parents = [nodes[name] for name in node.evaluated_with if name in nodes]
        return _register_extent(node, *parents)
    if node.kind in ("SwissKnife", "IntSwissKnife", "Converter", "IntConverter"):
        return _formulas_extent(node, extents)
    if node.kind == "Boolean":
        return TRUTH
    if node.kind in ("Integer", "Enumeration", "Float", "EnumEntry"):
        extent = NOTHING
        for text in node.texts("Value", "ValueIndexed", "ValueDefault"):
            written = Extent(bits=_WRITTEN_BITS, is_signed=True)
            extent = either(extent, either(written, extent_of_number(text)))
        for name in node.texts("pValue", "pValueIndexed", "pValueDefault"):
            extent = either(extent, extents.get(name, NOTHING))
        return extent
    return ANYTHING


def _register_extent(node: _Node, *around: _Node) -> Extent:
    """Extent of a register; what tells its length may be the structure around it."""
    texts = [text for one in (node, *around) for text in one.texts("Length")]
    lengths = [extent_of_number(text).literal or 0 for text in texts] or [4]
    bits = 8 * max(lengths)
    if bits > SAFE_BITS:
        return ANYTHING
    return Extent(bits=bits, is_signed="Signed" in node.texts("Sign"))


def _formulas_extent(node: _Node, extents: Mapping[str, Extent]) -> Extent:
    variables = {
        "PI": Extent(bits=2),
        "E": Extent(bits=2),
        "FROM": Extent(bits=_WRITTEN_BITS, is_signed=True),
    }
    for name in node.texts("pValue"):
        variables["TO"] = extents.get(name, NOTHING)
    expressions: dict[str, str] = {}
    for item in node.properties:
        variable = item.attributes.get("Name", "")
        if item.tag == "pVariable":
            known = extents.get(item.text, ANYTHING)
            variables[variable] = either(known, variables.get(variable, NOTHING))
        elif item.tag == "Constant":
            variables[variable] = extent_of_number(item.text)
        elif item.tag == "Expression":
            expressions[variable] = item.text
    is_integer = node.kind == "IntSwissKnife"
    for text in (*expressions.values(), *node.texts("Formula", "FormulaTo", "FormulaFrom")):
        if len(text) > LONGEST_FORMULA:
            raise DescriptionError(
                f"has a formula of {len(text)} letters ({node.name})",
                fault="formula",
                nodes=(node.name,),
            )
    for variable, text in expressions.items():
        variables[variable] = formula_extent(text, variables, is_integer=is_integer)
    found = [
        formula_extent(text, variables, is_integer=is_integer)
        for text in node.texts("Formula", "FormulaFrom")
    ]
    for text in node.texts("FormulaTo"):
        formula_extent(text, variables, is_integer=is_integer)
    return found[0] if len(found) == 1 else ANYTHING
