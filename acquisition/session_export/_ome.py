"""A session as OME-TIFF (BigTIFF) or OME-Zarr 0.5, with its metadata as OME-XML.

Each capture is an image of its own, since the scale differs from height to height: its channels
are the mean and the temporal variance of one frame, float32.

References
----------
Open Microscopy Environment: OME data model, schema of June 2016,
http://www.openmicroscopy.org/Schemas/OME/2016-06.
OME-NGFF 0.5, https://ngff.openmicroscopy.org/0.5: ``multiscales``, and the layout of
``bioformats2raw``, which holds several images and ``OME/METADATA.ome.xml``.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4
from xml.etree import ElementTree as ET

import numpy as np
import tifffile

from acquisition.session import CaptureImages, CaptureRecord, Session
from acquisition.session_export._source import ExportSource

_NAMESPACE = "http://www.openmicroscopy.org/Schemas/OME/2016-06"
_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_PROVENANCE, _SESSION = "Annotation:0", "Annotation:1"
_FIRST_RECORD = 2


class _OmeDocument:
    """OME-XML of an export, made image by image, for the TIFF file that holds it or a folder."""

    def __init__(self, source: ExportSource, *, has_pixels_here: bool) -> None:
        self._source = source
        self._has_pixels_here = has_pixels_here
        self._planes = 0
        self._images: list[ET.Element] = []
        self._annotations = [
            _map_annotation(_PROVENANCE, "standoff/provenance", dict(_provenance(source))),
            _map_annotation(_SESSION, "standoff/session", dict(_session(source.session))),
        ]

    def add(self, record: CaptureRecord, shape: tuple[int, int], channels: int) -> None:
        """Add a capture of ``(rows, cols)`` whose planes follow those before."""
        number = len(self._images)
        annotation = f"Annotation:{number + _FIRST_RECORD}"
        facts = {key: value for key, value in record.to_json().items() if value is not None}
        self._annotations.append(_map_annotation(annotation, "standoff/capture", facts))
        image = ET.Element("Image", {"ID": f"Image:{number}", "Name": _image_name(record)})
        _text(image, "AcquisitionDate", record.started_utc)
        ET.SubElement(image, "ExperimenterRef", {"ID": "Experimenter:0"})
        _text(image, "Description", _description(record))
        ET.SubElement(image, "InstrumentRef", {"ID": "Instrument:0"})
        ET.SubElement(
            image, "StageLabel", {"Name": "height", "Z": _number(record.height_mm), "ZUnit": "mm"}
        )
        image.append(self._pixels(number, record, shape, channels))
        for reference in (_PROVENANCE, _SESSION, annotation):
            ET.SubElement(image, "AnnotationRef", {"ID": reference})
        self._images.append(image)

    def to_bytes(self) -> bytes:
        """The document, in UTF-8."""
        root = ET.Element(
            "OME",
            {
                "xmlns": _NAMESPACE,
                "xmlns:xsi": _XSI,
                "xsi:schemaLocation": f"{_NAMESPACE} {_NAMESPACE}/ome.xsd",
                "Creator": f"standoff {self._source.provenance['version']}",
                "UUID": f"urn:uuid:{uuid4()}",
            },
        )
        operator = {"ID": "Experimenter:0", "UserName": self._source.session.manifest.operator}
        ET.SubElement(root, "Experimenter", operator)
        root.append(_instrument(self._source.session))
        root.extend(self._images)
        ET.SubElement(root, "StructuredAnnotations").extend(self._annotations)
        return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))

    def _pixels(
        self, number: int, record: CaptureRecord, shape: tuple[int, int], channels: int
    ) -> ET.Element:
        rows, cols = shape
        facts = {
            "ID": f"Pixels:{number}",
            "DimensionOrder": "XYCZT",
            "Type": "float",
            "BigEndian": "false",
            "SizeX": str(cols),
            "SizeY": str(rows),
            "SizeC": str(channels),
            "SizeZ": "1",
            "SizeT": "1",
        }
        scale = self._source.scale_px_per_mm(record)
        if scale is not None:
            for axis in "XY":
                facts |= {
                    f"PhysicalSize{axis}": _number(1 / scale),
                    f"PhysicalSize{axis}Unit": "mm",
                }
        pixels = ET.Element("Pixels", facts)
        for channel, name in enumerate(("mean", "variance")[:channels]):
            element = ET.SubElement(
                pixels,
                "Channel",
                {"ID": f"Channel:{number}:{channel}", "Name": name, "SamplesPerPixel": "1"},
            )
            ET.SubElement(element, "DetectorSettings", _detector_settings(record))
        if self._has_pixels_here:
            for channel in range(channels):
                ET.SubElement(
                    pixels,
                    "TiffData",
                    {"FirstC": str(channel), "IFD": str(self._planes), "PlaneCount": "1"},
                )
                self._planes += 1
        else:
            ET.SubElement(pixels, "MetadataOnly")
        for channel in range(channels):
            ET.SubElement(pixels, "Plane", {"TheC": str(channel), **_plane(record)})
        return pixels


def _image_name(record: CaptureRecord) -> str:
    """Name of a capture, as its file is called."""
    return record.file.rpartition("/")[2].removesuffix(".tif")


def _plane(record: CaptureRecord) -> dict[str, str]:
    facts = {"TheZ": "0", "TheT": "0"}
    if record.exposure_us is not None:
        facts |= {"ExposureTime": _number(record.exposure_us), "ExposureTimeUnit": "µs"}
    return facts | {"PositionZ": _number(record.height_mm), "PositionZUnit": "mm"}


def _detector_settings(record: CaptureRecord) -> dict[str, str]:
    """Gain in dB, the black level as offset, and how many frames were averaged."""
    facts = {"ID": "Detector:0", "Offset": _number(record.black_level_dn)}
    if record.gain_db is not None:
        facts["Gain"] = _number(record.gain_db)
    return facts | {"Integration": str(record.frames_used)}


def _instrument(session: Session) -> ET.Element:
    instrument = ET.Element("Instrument", {"ID": "Instrument:0"})
    camera = session.devices.get("camera", {})
    names = {
        "Manufacturer": "DeviceVendorName",
        "Model": "DeviceModelName",
        "SerialNumber": "DeviceSerialNumber",
    }
    known = {name: str(camera[key]) for name, key in names.items() if camera.get(key)}
    ET.SubElement(instrument, "Detector", {"ID": "Detector:0", "Type": "Other", **known})
    return instrument


def _description(record: CaptureRecord) -> str:
    return (
        f"{record.kind} {record.target} at {record.orientation_deg:g} degrees, mean of "
        f"{record.frames_used} frames in DN, linear in light; the variance is that of one frame, "
        "in DN^2"
    )


def _provenance(source: ExportSource) -> Iterator[tuple[str, object]]:
    made = source.provenance
    yield from ((name, made[name]) for name in ("version", "created", "command"))
    for number, file in enumerate(made["inputs"]):
        yield f"inputs.{number}.path", file["path"]
        yield f"inputs.{number}.sha256", file["sha256"]


def _session(session: Session) -> Iterator[tuple[str, object]]:
    manifest = session.manifest
    yield from {
        "uid": manifest.uid,
        "created_utc": manifest.created_utc,
        "operator": manifest.operator,
        "plan": json.dumps(manifest.plan.to_json(), ensure_ascii=False),
        "bench": json.dumps(manifest.bench, ensure_ascii=False),
        "devices": json.dumps(manifest.devices, ensure_ascii=False),
        "software": json.dumps(manifest.software, ensure_ascii=False),
    }.items()


def _map_annotation(identity: str, namespace: str, facts: Mapping[str, object]) -> ET.Element:
    annotation = ET.Element("MapAnnotation", {"ID": identity, "Namespace": namespace})
    value = ET.SubElement(annotation, "Value")
    for key, fact in facts.items():
        ET.SubElement(value, "M", {"K": key}).text = _printed(str(fact))
    return annotation


def _text(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, name).text = _printed(text)


def _printed(text: str) -> str:
    """The text without control characters, which XML 1.0 cannot hold."""
    return "".join(
        character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text
    )


def _number(value: float) -> str:
    return np.format_float_positional(value, trim="-")


def write_ome_tiff(path: Path, source: ExportSource) -> None:
    """Write every capture; the OME-XML, which names the pages, comes last."""
    document = _OmeDocument(source, has_pixels_here=True)
    with tifffile.TiffWriter(path, bigtiff=True, byteorder="<", ome=False) as file:
        description = "to be replaced"
        for images in source.captures():
            planes = [images.mean_dn]
            if images.variance_dn2 is not None:
                planes.append(images.variance_dn2)
            for plane in planes:
                file.write(
                    plane,
                    photometric="minisblack",
                    metadata=None,
                    description=description,
                    software="standoff",
                )
                description = ""
            document.add(images.record, images.mean_dn.shape, len(planes))
    tifffile.tiffcomment(path, document.to_bytes())


_VERSION = "0.5"
_CHUNK_PX = 1024


def write_ome_zarr(path: Path, source: ExportSource) -> None:
    """Write every capture as an image ``(c, z, y, x)``: z is its height."""
    import zarr

    document = _OmeDocument(source, has_pixels_here=False)
    layout = {"ome": {"version": _VERSION, "bioformats2raw.layout": 3}}
    made = {"standoff": {"provenance": dict(source.provenance)}}
    root = zarr.create_group(path, zarr_format=3, attributes={**layout, **made})
    series = []
    for number, images in enumerate(source.captures()):
        name = str(number)
        group = root.create_group(name, attributes=_image_attributes(images, source))
        planes = _planes(images)
        channels, _, rows, cols = planes.shape
        array = group.create_array(
            "0",
            shape=planes.shape,
            chunks=(1, 1, min(rows, _CHUNK_PX), min(cols, _CHUNK_PX)),
            dtype=planes.dtype,
            dimension_names=["c", "z", "y", "x"],
        )
        array[...] = planes
        document.add(images.record, (rows, cols), channels)
        series.append(name)
    root.create_group("OME", attributes={"ome": {"version": _VERSION, "series": series}})
    (path / "OME" / "METADATA.ome.xml").write_bytes(document.to_bytes())


def _planes(images: CaptureImages) -> np.ndarray[Any, np.dtype[np.float32]]:
    channels = [images.mean_dn]
    if images.variance_dn2 is not None:
        channels.append(images.variance_dn2)
    return np.stack(channels)[:, np.newaxis]


def _image_attributes(images: CaptureImages, source: ExportSource) -> dict[str, Any]:
    record = images.record
    scale = source.scale_px_per_mm(record)
    pixel, unit = (1.0, {}) if scale is None else (1 / scale, {"unit": "millimeter"})
    multiscale = {
        "name": _image_name(record),
        "axes": [
            {"name": "c", "type": "channel"},
            {"name": "z", "type": "space", "unit": "millimeter"},
            {"name": "y", "type": "space", **unit},
            {"name": "x", "type": "space", **unit},
        ],
        "datasets": [
            {
                "path": "0",
                "coordinateTransformations": [
                    {"type": "scale", "scale": [1.0, 1.0, pixel, pixel]},
                    {"type": "translation", "translation": [0.0, record.height_mm, 0.0, 0.0]},
                ],
            }
        ],
    }
    windows = {"mean": (0.0, record.max_level_dn)}
    if images.variance_dn2 is not None:
        windows["variance"] = (0.0, float(images.variance_dn2.max()) or 1.0)
    channels = [
        {
            "label": label,
            "color": "FFFFFF",
            "active": label == "mean",
            "window": {"min": low, "start": low, "end": high, "max": high},
        }
        for label, (low, high) in windows.items()
    ]
    return {
        "ome": {"version": _VERSION, "multiscales": [multiscale], "omero": {"channels": channels}},
        "standoff": {"capture": record.to_json()},
    }
