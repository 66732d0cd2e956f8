"""The GenICam description (XML) of the simulated GigE camera, written from its feature table.

References
----------
GenICam Standard, GenApi 2.1.1, EMVA, 2018: node types and their elements.
"""

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement, tostring

from hil_mocks.gige._events import EVENT_NAMES, EVENT_PARTS, EventId
from hil_mocks.gige._features import Feature

DESCRIPTION_FILE = "standoff_gige_camera.xml"
NAMESPACE = "http://www.genicam.org/GenApi/Version_1_1"

STRINGS = (
    ("DeviceVendorName", 0x0048, 32),
    ("DeviceModelName", 0x0068, 32),
    ("DeviceVersion", 0x0088, 32),
    ("DeviceFirmwareVersion", 0x0088, 32),
    ("DeviceID", 0x00D8, 16),
    ("DeviceSerialNumber", 0x00D8, 16),
    ("DeviceUserID", 0x00E8, 16),
)
"""Device names in the bootstrap registers: feature, address and length."""

WRITABLE_STRINGS = ("DeviceUserID",)


def describe(features: Iterable[Feature], *, vendor: str, model: str) -> bytes:
    """Return the XML document that describes a camera with these features."""
    features = tuple(features)
    root = Element(
        "RegisterDescription",
        {
            "xmlns": NAMESPACE,
            "ModelName": _identifier(model),
            "VendorName": _identifier(vendor),
            "StandardNameSpace": "GEV",
            "SchemaMajorVersion": "1",
            "SchemaMinorVersion": "1",
            "SchemaSubMinorVersion": "0",
            "MajorVersion": "1",
            "MinorVersion": "0",
            "SubMinorVersion": "0",
            "ProductGuid": "5b0b38c0-6a75-4f0e-a9e6-0f3f6f0d9a11",
            "VersionGuid": "5b0b38c0-6a75-4f0e-a9e6-0f3f6f0d9a12",
        },
    )
    _categories(root, features)
    for name, address, length in STRINGS:
        access = "RW" if name in WRITABLE_STRINGS else "RO"
        _add(
            SubElement(root, "StringReg", Name=name),
            Address=f"{address:#x}",
            Length=str(length),
            AccessMode=access,
            pPort="Device",
        )
    for feature in features:
        selected = [other.name for other in features if other.selector == feature.name]
        _feature(root, feature, selected)
        _register(root, feature)
        if feature.chunk_id is not None:
            _add(SubElement(root, "Port", Name=_port(feature)), ChunkID=f"{feature.chunk_id:x}")
    for event in EVENT_NAMES:
        _event(root, event)
    SubElement(root, "Port", Name="Device")
    document: bytes = tostring(root, encoding="utf-8")
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + document


def _categories(root: Element, features: tuple[Feature, ...]) -> None:
    members: dict[str, list[str]] = {"DeviceControl": [name for name, _, _ in STRINGS]}
    for feature in features:
        members.setdefault(feature.category, []).append(feature.name)
    for event, name in EVENT_NAMES.items():
        parts = [f"Event{name}{part}" for part, _, _ in EVENT_PARTS[event]]
        members.setdefault("EventControl", []).extend(parts)
    top = SubElement(root, "Category", Name="Root")
    for category in members:
        _add(top, pFeature=category)
    for category, names in members.items():
        node = SubElement(root, "Category", Name=category)
        for name in names:
            _add(node, pFeature=name)


def _feature(root: Element, feature: Feature, selected: list[str]) -> None:
    tag = {
        "integer": "Integer",
        "masked": "Integer",
        "float": "Float",
        "enumeration": "Enumeration",
        "boolean": "Boolean",
        "flag": "Boolean",
        "command": "Command",
    }[feature.kind]
    node = SubElement(root, tag, Name=feature.name)
    _add(node, Description=feature.description)
    if feature.is_locked_while_acquiring:
        _add(node, pIsLocked="AcquisitionActive")
    for name, value in feature.entries:
        _add(SubElement(node, "EnumEntry", Name=name), Value=str(value))
    for name in selected:
        _add(node, pSelected=name)
    _add(node, pValue=f"{feature.name}Reg")
    if tag == "Boolean":
        _add(node, OnValue="1", OffValue="0")
    elif feature.kind == "command":
        _add(node, CommandValue="1")
    else:
        for element, limit in (("Min", feature.minimum), ("Max", feature.maximum)):
            if isinstance(limit, str):
                _add(node, **{f"p{element}": limit})
            elif limit is not None:
                _add(node, **{element: _number(limit)})
        if feature.increment is not None:
            _add(node, Inc=_number(feature.increment))
        if feature.unit:
            _add(node, Unit=feature.unit)


def _register(root: Element, feature: Feature) -> None:
    tag = "FloatReg" if feature.kind == "float" else "IntReg"
    if feature.bits is not None:
        tag = "MaskedIntReg"
    node = SubElement(root, tag, Name=f"{feature.name}Reg")
    _add(
        node,
        Address="0" if feature.chunk_id is not None else f"{feature.address:#x}",
        Length=str(feature.length),
        AccessMode=feature.access,
        pPort=_port(feature),
        Cachable="NoCache",
    )
    if feature.bits is not None:
        lsb, msb = map(str, feature.bits)
        _add(node, **({"Bit": lsb} if lsb == msb else {"LSB": lsb, "MSB": msb}))
    if tag != "FloatReg":
        _add(node, Sign="Unsigned")
    _add(node, Endianess="BigEndian")


def _port(feature: Feature) -> str:
    return "Device" if feature.chunk_id is None else f"{feature.name}Port"


def _event(root: Element, event: EventId) -> None:
    """What a client reads in an event that has come; its port is the event itself."""
    name = f"Event{EVENT_NAMES[event]}"
    for part, address, length in EVENT_PARTS[event]:
        _add(SubElement(root, "Integer", Name=name + part), pValue=f"{name}{part}Reg")
        _add(
            SubElement(root, "IntReg", Name=f"{name}{part}Reg"),
            Address=str(address),
            Length=str(length),
            AccessMode="RO",
            pPort=f"{name}Port",
            Cachable="NoCache",
            Sign="Unsigned",
            Endianess="BigEndian",
        )
    _add(SubElement(root, "Port", Name=f"{name}Port"), EventID=f"{event:04x}")


def _add(node: Element, **texts: str) -> None:
    """Add an element for each text, in order, by the element's name."""
    for tag, text in texts.items():
        SubElement(node, tag).text = text


def _number(value: float) -> str:
    return str(int(value)) if float(value).is_integer() else repr(float(value))


def _identifier(text: str) -> str:
    """The text as an XML name: any character but letters and digits becomes an underscore."""
    return "".join(letter if letter.isalnum() else "_" for letter in text)
