"""Whether a description can be given to Aravis, which trusts every word of it.

What is refused ends the process inside Aravis, or keeps it busy for ever, when the feature
concerned is evaluated; found with Aravis 0.8.26, whose later versions up to 0.8.35 do the same.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from acquisition.aravis.description.formulas import (
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
from acquisition.aravis.description.nodes import DescriptionError, Node, parse_nodes
from acquisition.aravis.description.references import (
    evaluated_names,
    evaluation_order,
    require_complete,
    require_short_chains,
)
from acquisition.errors import CameraDescriptionError
from acquisition.printable import on_one_line

LONGEST_REGISTER_BYTES = 1 << 20
"""Aravis takes as much memory as a register is long, and ends the process if it gets none."""

NUMBERS = ("IntReg", "MaskedIntReg", "FloatReg", "StructReg")
"""Registers that are numbers: the length of the standard's others may come from another node."""

REGISTERS = (*NUMBERS, "StringReg", "Register")
WRITTEN_BITS = 53
"""Of a node without a register, which keeps what was written to it."""

REMEDY = (
    "its firmware is damaged or not the maker's: install the maker's firmware anew, or use "
    "another camera"
)

CHUNK_ID = "ChunkID"


@dataclass(frozen=True, slots=True, kw_only=True)
class SoundDescription:
    """What the driver asks of a description that was found sound.

    ``needed`` names what each node is evaluated from. ``in_chunks`` are the registers that lie in
    what a frame carries beside its picture, ``of_open_length`` those whose length another node
    tells: how long they are, and where they lie, only the camera says.
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
    """Refuse a description that takes Aravis down.

    Parameters
    ----------
    data
        The document, unpacked.
    camera
        Which camera it is, for the error: "the camera at ...".

    Raises
    ------
    CameraDescriptionError
        If it is no sound description; the error names the nodes at fault.
    """
    try:
        return _checked(data.partition(b"\0")[0])
    except DescriptionError as error:
        raise description_error(error, camera) from error


def description_error(error: DescriptionError, camera: str) -> CameraDescriptionError:
    """The error that a person reads, of this camera."""
    return CameraDescriptionError(
        on_one_line(f"the description of {camera} {error}; {REMEDY}"),
        fault=error.fault,
        nodes=error.nodes,
    )


@lru_cache(maxsize=2)
def _checked(data: bytes) -> SoundDescription:
    """Check a description; that of a camera that is opened again is not checked again."""
    nodes = parse_nodes(data)
    order = evaluation_order(nodes)
    require_short_chains(nodes, order)
    require_complete(nodes)
    for node in nodes.values():
        _require_bounded_register(node)
    _require_safe_formulas(nodes, order)
    ports = {node.name for node in nodes.values() if any(node.texts(CHUNK_ID))}
    return SoundDescription(
        needed={name: tuple(evaluated_names(node)) for name, node in nodes.items()},
        in_chunks=frozenset(
            node.name for node in nodes.values() if not ports.isdisjoint(node.texts("pPort"))
        ),
        of_open_length=frozenset(
            node.name for node in nodes.values() if any(node.texts("pLength"))
        ),
    )


def _require_bounded_register(node: Node) -> None:
    if node.kind not in REGISTERS:
        return
    if node.kind in NUMBERS and any(node.texts("pLength")):
        raise DescriptionError(
            f"leaves open how long the number in {node.name} is",
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


def _require_safe_formulas(nodes: Mapping[str, Node], order: tuple[str, ...]) -> None:
    extents: dict[str, Extent] = {}
    for name in order:
        node = nodes[name]
        try:
            extents[name] = _extent_of(node, nodes, extents)
        except OverflowingDivisionError as error:
            raise DescriptionError(
                f"has a formula that {error} ({name})", fault="formula", nodes=(name,)
            ) from error


def _extent_of(node: Node, nodes: Mapping[str, Node], extents: Mapping[str, Extent]) -> Extent:
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
            written = Extent(bits=WRITTEN_BITS, is_signed=True)
            extent = either(extent, either(written, extent_of_number(text)))
        for name in node.texts("pValue", "pValueIndexed", "pValueDefault"):
            extent = either(extent, extents.get(name, NOTHING))
        return extent
    return ANYTHING


def _register_extent(node: Node, *around: Node) -> Extent:
    """Extent of a register; what tells its length may be the structure around it."""
    texts = [text for one in (node, *around) for text in one.texts("Length")]
    lengths = [extent_of_number(text).literal or 0 for text in texts] or [4]
    bits = 8 * max(lengths)
    if bits > SAFE_BITS:
        return ANYTHING
    return Extent(bits=bits, is_signed="Signed" in node.texts("Sign"))


def _formulas_extent(node: Node, extents: Mapping[str, Extent]) -> Extent:
    variables = {
        "PI": Extent(bits=2),
        "E": Extent(bits=2),
        "FROM": Extent(bits=WRITTEN_BITS, is_signed=True),
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
