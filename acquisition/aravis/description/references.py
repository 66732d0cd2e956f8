"""Which nodes of a description are evaluated for which others: circles, long chains, gaps.

Aravis evaluates a node by calling itself for each node that this one needs. It does not notice a
circle, but fills the stack, and the process dies (Aravis 0.8.26 to 0.8.35). What a node needs for
its value is in `EVALUATED`. ``pMin``, ``pMax``, ``pInc``, ``pIsImplemented``, ``pIsAvailable`` and
``pIsLocked`` are asked for beside the value, never for it: a width whose maximum depends on an
offset, whose maximum depends on the width, is no circle of evaluation. ``pSelected``,
``pInvalidator`` and ``pFeature`` are not followed at all.
"""

from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter

from acquisition.aravis.description.nodes import DescriptionError, Node

EVALUATED = (
    "pValue",
    "pValueIndexed",
    "pValueDefault",
    "pVariable",
    "pAddress",
    "pLength",
    "pIndex",
)
OFFSET = "pOffset"
"""Attribute of a ``pIndex``; evaluated, too."""

NEEDED = (*EVALUATED, "pPort", "pMin", "pMax", "pInc", "pCommandValue")
"""References to a node that does not exist; Aravis takes them for 0."""

LONGEST_CHAIN = 200
"""Nodes that need each other in a row. Real cameras have up to 20; 100 000 fill the stack."""

MOST_EVALUATIONS = 20_000
"""For one value: nodes count as often as they are evaluated. Real cameras have up to 442."""

ADDED_BY_ARAVIS = ("GevSCPSPacketSize", "GevSCPD", "TLParamsLocked")
PREFIX_OF_ARAVIS = "ArvGev"
"""Nodes that Aravis adds itself where the camera has none of the name."""

NAMES_SHOWN = 6


def evaluated_names(node: Node) -> Iterator[str]:
    """Names of the nodes that are evaluated for the value of this one."""
    yield from node.evaluated_with
    for item in node.properties:
        if item.tag in EVALUATED:
            yield item.text
        if OFFSET in item.attributes:
            yield item.attributes[OFFSET].strip()


def evaluation_order(nodes: Mapping[str, Node]) -> tuple[str, ...]:
    """Names of all nodes, each after those that it is evaluated from.

    Raises
    ------
    DescriptionError
        If there is a circle; its ``nodes`` are the names around it, the first one again at the end.
    """
    graph = {
        name: [needed for needed in evaluated_names(node) if needed in nodes]
        for name, node in nodes.items()
    }
    try:
        return tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        around = tuple(reversed(error.args[1]))  # as they refer to each other
        raise DescriptionError(
            f"refers to itself ({_shown(around)})", fault="circle", nodes=around
        ) from error


def require_complete(nodes: Mapping[str, Node]) -> None:
    """Refuse references to nodes that do not exist, and nodes in place of Aravis' own.

    Raises
    ------
    DescriptionError
        Its ``nodes`` are the one that refers and the one that is missing.
    """
    for node in nodes.values():
        if node.name.startswith(PREFIX_OF_ARAVIS):
            raise DescriptionError(
                f"has a node {node.name}, which is Aravis' own", fault="node", nodes=(node.name,)
            )
        for tag, name in _needed(node):
            if name not in nodes and not _is_added(name):
                raise DescriptionError(
                    f"refers to a node that it does not have ({node.name}: {tag} {name[:60]!r})",
                    fault="missing node",
                    nodes=(node.name, name),
                )


def require_short_chains(nodes: Mapping[str, Node], order: tuple[str, ...]) -> None:
    """Refuse chains of references that fill the stack, and values that take for ever.

    Parameters
    ----------
    order
        As from `evaluation_order`.

    Raises
    ------
    DescriptionError
        Its ``nodes`` are the one that the chain begins at.
    """
    lengths: dict[str, int] = {}
    evaluations: dict[str, int] = {}
    for name in order:
        needed = [other for other in evaluated_names(nodes[name]) if other in nodes]
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


def _needed(node: Node) -> Iterator[tuple[str, str]]:
    for item in node.properties:
        if item.tag in NEEDED:
            yield item.tag, item.text
        if OFFSET in item.attributes:
            yield OFFSET, item.attributes[OFFSET].strip()


def _is_added(name: str) -> bool:
    return name in ADDED_BY_ARAVIS or name.startswith(PREFIX_OF_ARAVIS)


def _shown(names: tuple[str, ...]) -> str:
    if len(names) > NAMES_SHOWN:
        half = NAMES_SHOWN // 2
        names = (*names[:half], f"{len(names) - NAMES_SHOWN} more", *names[-half:])
    return " -> ".join(name[:60] for name in names)
