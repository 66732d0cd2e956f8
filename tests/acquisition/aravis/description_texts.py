"""Descriptions of a camera, whole and damaged, for the tests."""

from collections.abc import Iterable, Mapping

from hil_mocks.gige._description import describe
from hil_mocks.gige._features import features_of

HEAD = (
    '<?xml version="1.0" encoding="utf-8"?>\n'
    '<RegisterDescription ModelName="m" VendorName="v" SchemaMajorVersion="1" '
    'SchemaMinorVersion="1" SchemaSubMinorVersion="0">'
)
TAIL = "</RegisterDescription>"

REGISTER = (
    '<IntReg Name="R"><Address>0xa010</Address><Length>4</Length><AccessMode>RW</AccessMode>'
    "<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
)
"""The register of the simulated camera's width."""

CIRCLES = {
    "pValue": ("Integer", "<pValue>{other}</pValue>"),
    "pVariable": (
        "IntSwissKnife",
        '<pVariable Name="V">{other}</pVariable><Formula>V</Formula>',
    ),
    "pAddress": ("IntReg", "<pAddress>{other}</pAddress><Length>4</Length><pPort>Device</pPort>"),
    "pIndex": (
        "IntReg",
        "<Address>0xa010</Address><pIndex>{other}</pIndex><Length>4</Length><pPort>Device</pPort>",
    ),
    "pOffset": (
        "IntReg",
        '<Address>0xa010</Address><pIndex pOffset="{other}">R</pIndex><Length>4</Length>'
        "<pPort>Device</pPort>",
    ),
    "nested knife": (
        "IntReg",
        '<IntSwissKnife><pVariable Name="V">{other}</pVariable><Formula>V</Formula>'
        "</IntSwissKnife><Length>4</Length><pPort>Device</pPort>",
    ),
    "pValueIndexed": (
        "Integer",
        '<pIndex>R</pIndex><pValueIndexed Index="0">{other}</pValueIndexed>'
        "<pValueDefault>R</pValueDefault>",
    ),
    "pValueDefault": ("Integer", "<pIndex>R</pIndex><pValueDefault>{other}</pValueDefault>"),
    "converter": (
        "IntConverter",
        "<FormulaTo>FROM</FormulaTo><FormulaFrom>TO</FormulaFrom><pValue>{other}</pValue>",
    ),
    "enumeration": (
        "Enumeration",
        '<EnumEntry Name="On"><Value>1</Value></EnumEntry><pValue>{other}</pValue>',
    ),
}
"""By the reference that a value is evaluated through: the node that refers, and how it does."""

HARMLESS = {
    name: ("Integer", f"<pValue>R</pValue><{name}>{{other}}</{name}>")
    for name in (
        "pMin",
        "pMax",
        "pInc",
        "pIsImplemented",
        "pIsAvailable",
        "pIsLocked",
        "pSelected",
        "pInvalidator",
        "pError",
        "pAlias",
    )
}
"""References that are asked for beside a value, or not followed at all."""


def description(*nodes: str) -> bytes:
    """A description of these nodes, a port and a register."""
    return "".join((HEAD, *nodes, REGISTER, '<Port Name="Device"/>', TAIL)).encode()


def node(kind: str, name: str, inside: str) -> str:
    return f'<{kind} Name="{name}">{inside}</{kind}>'


def in_a_row(kind: str, inside: str, names: Iterable[str]) -> str:
    """Nodes of which each refers to the next one, and the last one to the first."""
    row = list(names)
    following = [*row[1:], row[0]]
    return "".join(
        node(kind, name, inside.format(other=other))
        for name, other in zip(row, following, strict=True)
    )


def graph_of(references: Mapping[str, Iterable[str]]) -> bytes:
    """Formulas of which each needs the others that it refers to."""
    return description(
        *(
            node(
                "IntSwissKnife",
                name,
                "".join(
                    f'<pVariable Name="V{place}">{other}</pVariable>'
                    for place, other in enumerate(others)
                )
                + "<Formula>1</Formula>",
            )
            for name, others in references.items()
        )
    )


def simulated() -> bytes:
    """The description of the simulated camera."""
    return describe(features_of(None, has_temperature=True), vendor="v", model="m")


def with_nodes(*nodes: str) -> bytes:
    """The description of the simulated camera with these nodes beside its own."""
    return simulated().replace(TAIL.encode(), "".join((*nodes, TAIL)).encode())


def with_width(inside: str, *nodes: str) -> bytes:
    """The description of the simulated camera, its width made of this in place of its register."""
    before = b"<pValue>WidthReg</pValue>"
    text = with_nodes(*nodes)
    assert text.count(before) == 1
    return text.replace(before, inside.encode())
