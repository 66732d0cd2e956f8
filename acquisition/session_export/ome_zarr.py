"""A session as OME-Zarr 0.5: a group with one image for each capture, and the OME-XML of all.

References
----------
OME-NGFF 0.5, https://ngff.openmicroscopy.org/0.5: ``multiscales``, and the layout of
``bioformats2raw``, which holds several images and ``OME/METADATA.ome.xml``.
"""

from pathlib import Path
from typing import Any

import numpy as np

from acquisition.session import CaptureImages
from acquisition.session_export.ome_model import OmeDocument, image_name
from acquisition.session_export.source import ExportSource

_VERSION = "0.5"
_CHUNK_PX = 1024


def write_ome_zarr(path: Path, source: ExportSource) -> None:
    """Write every capture as an image ``(c, z, y, x)``: z is its height.

    Raises
    ------
    SessionError
        If a capture cannot be read.
    OSError
        If a file cannot be written.
    """
    import zarr

    document = OmeDocument(source, has_pixels_here=False)
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
        "name": image_name(record),
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
