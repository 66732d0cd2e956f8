"""A session as NeXus: an ``NXentry`` for each target and orientation, over the heights.

References
----------
NeXus International Advisory Committee: NXDL base classes, https://manual.nexusformat.org:
``NXentry``, ``NXdetector``, ``NXpositioner``, ``NXdata``.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.session import CaptureImages, CaptureRecord, Session
from acquisition.session_export._source import ExportSource

_Key = tuple[str, str, float, tuple[int, int]]

_COLUMN_UNITS = {
    "orientation_deg": "deg",
    "height_asked_mm": "mm",
    "height_mm": "mm",
    "exposure_us": "us",
    "gain_db": "dB",
    "min_dn": "DN",
    "max_dn": "DN",
    "black_level_dn": "DN",
    "max_level_dn": "DN",
    "scale_px_per_mm": "1/mm",
    "first_timestamp_ns": "ns",
    "last_timestamp_ns": "ns",
}


def write_nexus(path: Path, source: ExportSource) -> None:
    """Write every capture, one at a time."""
    import h5py

    with h5py.File(path, "w") as file:
        entries: dict[_Key, _Entry] = {}
        for images in source.captures():
            record = images.record
            key = (record.kind, record.target, record.orientation_deg, images.mean_dn.shape)
            if key not in entries:
                group = _group(file, f"entry{len(entries) + 1}", "NXentry")
                entries[key] = _Entry(group, source, images)
            entries[key].add(images)
        for entry in entries.values():
            entry.finish()
        file.attrs["creator"] = f"standoff {source.provenance['version']}"
        if entries:
            file.attrs["default"] = "entry1"


class _Entry:
    """The captures of one target at one orientation and of one shape."""

    def __init__(self, group: Any, source: ExportSource, first: CaptureImages) -> None:  # noqa: ANN401 - h5py has no types
        self._group = group
        self._source = source
        self._records: list[CaptureRecord] = []
        session, record = source.session, first.record
        _fields(
            group,
            {
                "title": f"{record.kind} {record.target} at {record.orientation_deg:g} degrees",
                "collection_identifier": session.manifest.uid,
                "collection_description": session.plan.name,
                "program_name": ("standoff", {"version": source.provenance["version"]}),
            },
        )
        _fields(_group(group, "user", "NXuser"), {"name": session.manifest.operator})
        sample = _group(group, "sample", "NXsample")
        _fields(
            sample,
            {
                "name": record.target,
                "description": record.kind,
                "rotation_angle": (record.orientation_deg, {"units": "deg"}),
            },
        )
        instrument = _group(group, "instrument", "NXinstrument")
        self._detector = _group(instrument, "camera", "NXdetector")
        self._stage = _group(instrument, "stage", "NXpositioner")
        shape = first.mean_dn.shape
        names = ["data"] + ["data_errors"] * (first.variance_dn2 is not None)
        self._stacks = {
            name: self._detector.create_dataset(
                name, (0, *shape), np.float32, maxshape=(None, *shape), chunks=(1, *shape)
            )
            for name in names
        }
        for stack in self._stacks.values():
            stack.attrs["units"] = "DN"
        self._stacks["data"].attrs["long_name"] = "mean level"

    def add(self, images: CaptureImages) -> None:
        """Append a capture: its mean, and the standard error of the mean."""
        number = len(self._records)
        for stack in self._stacks.values():
            stack.resize(number + 1, axis=0)
        self._stacks["data"][number] = images.mean_dn
        if "data_errors" in self._stacks:
            self._stacks["data_errors"][number] = (
                np.nan
                if images.variance_dn2 is None
                else np.sqrt(images.variance_dn2 / images.record.frames_used)
            )
        self._records.append(images.record)

    def finish(self) -> None:
        """Write what is known of all captures: heights, times, light, provenance."""
        import h5py

        records, group = self._records, self._group
        first = records[0]
        _fields(
            group,
            {
                "start_time": min(record.started_utc for record in records),
                "end_time": max(record.finished_utc for record in records),
            },
        )
        self._describe_camera(first)
        self._describe_stage()
        data = _group(group, "data", "NXdata")
        for name, stack in self._stacks.items():
            data[name] = h5py.SoftLink(stack.name)
        data["height"] = h5py.SoftLink(self._stage["value"].name)
        data.attrs["signal"] = "data"
        data.attrs["height_indices"] = np.int32(0)
        data.attrs["axes"] = _texts(["height", ".", "."])
        scales = [self._source.scale_px_per_mm(record) for record in records]
        known = [scale for scale in scales if scale is not None]
        if len(known) == len(scales):
            # Places differ from height to height: axes of two dimensions, beside the default ones.
            for axis, name in ((1, "y"), (2, "x")):
                _fields(data, {name: (_places(known, self._shape[axis]), {"units": "mm"})})
                data.attrs[f"{name}_indices"] = np.array([0, axis], np.int32)
        group.attrs["default"] = "data"
        self._write_records()
        self._write_process()

    @property
    def _shape(self) -> tuple[int, ...]:
        return tuple(self._stacks["data"].shape)

    def _describe_camera(self, first: CaptureRecord) -> None:
        records = self._records
        seconds = [_known(r.exposure_us) * 1e-6 * r.frames_used for r in records]
        pitch_um = _pixel_pitch_um(self._source.session)
        camera = self._source.session.devices.get("camera", {})
        _fields(
            self._detector,
            {
                "description": " ".join(
                    str(camera[key])
                    for key in ("DeviceVendorName", "DeviceModelName")
                    if camera.get(key)
                ),
                "serial_number": str(camera.get("DeviceSerialNumber", "")),
                "layout": "area",
                "type": "area camera, mean of several frames",
                "count_time": (np.array(seconds), {"units": "s"}),
                "saturation_value": (np.float64(first.max_level_dn), {"units": "DN"}),
                "underload_value": (np.float64(first.black_level_dn), {"units": "DN"}),
                "gain_setting": "unknown" if first.gain_db is None else f"{first.gain_db:g} dB",
            },
        )
        if pitch_um is not None:
            for name in ("x_pixel_size", "y_pixel_size"):
                _fields(self._detector, {name: (pitch_um, {"units": "um"})})

    def _describe_stage(self) -> None:
        records = self._records
        asked_mm = np.array([record.height_asked_mm for record in records])
        _fields(
            self._stage,
            {
                "name": "height",
                "description": "height of the camera, as read back from the stage",
                "value": (np.array([r.height_mm for r in records]), {"units": "mm"}),
                "target_value": (asked_mm, {"units": "mm"}),
            },
        )
        limits_mm = self._source.session.devices.get("stage", {}).get("limits_mm")
        if limits_mm is not None:
            for name, limit_mm in zip(("soft_limit_min", "soft_limit_max"), limits_mm, strict=True):
                _fields(self._stage, {name: (float(limit_mm), {"units": "mm"})})

    def _write_records(self) -> None:
        """The journal's records, column by column; what NeXus has no field for is here alone."""
        table = _group(self._group, "captures", "NXcollection")
        rows = [record.to_json() for record in self._records]
        for name in rows[0]:
            values = [row[name] for row in rows]
            units = {"units": _COLUMN_UNITS[name]} if name in _COLUMN_UNITS else {}
            _fields(table, {name: (_column(values), units)})

    def _write_process(self) -> None:
        made, manifest = self._source.provenance, self._source.session.manifest
        process = _group(self._group, "export", "NXprocess")
        _fields(
            process,
            {"program": "standoff", "version": made["version"], "date": made["created"]},
        )
        documents: dict[str, Callable[[], object]] = {
            "provenance": lambda: dict(made),
            "session": lambda: json.loads(manifest.to_bytes()),
        }
        for name, document in documents.items():
            note = _group(process, name, "NXnote")
            text = json.dumps(document(), ensure_ascii=False, indent=1)
            _fields(note, {"type": "application/json", "data": text})


def _group(parent: Any, name: str, kind: str) -> Any:  # noqa: ANN401 - h5py has no types
    made = parent.create_group(name)
    made.attrs["NX_class"] = kind
    return made


def _fields(group: Any, values: Mapping[str, Any]) -> None:  # noqa: ANN401 - h5py has no types
    """Write fields; a pair is a value with its attributes. What is empty is left out."""
    for name, value in values.items():
        content, attributes = value if isinstance(value, tuple) else (value, {})
        if isinstance(content, str) and not content:
            continue
        made = group.create_dataset(name, data=content)
        for key, text in attributes.items():
            made.attrs[key] = text


def _places(scales_px_per_mm: list[float], pixels: int) -> NDArray[np.float64]:
    """Places on the target from the middle of the frame, in mm: shape ``(captures, pixels)``."""
    from_middle_px = np.arange(pixels) - (pixels - 1) / 2
    return np.asarray(from_middle_px / np.array(scales_px_per_mm)[:, np.newaxis])


def _column(values: list[Any]) -> NDArray[Any]:
    """Values of one key of all records: what is not known is NaN, or an empty text."""
    if any(isinstance(value, str) for value in values):
        return _texts(["" if value is None else value for value in values])
    if any(value is None for value in values):
        return np.array([_known(value) for value in values])
    return np.array(values)


def _texts(values: list[str]) -> NDArray[Any]:
    import h5py

    return np.array(values, dtype=h5py.string_dtype())


def _known(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _pixel_pitch_um(session: Session) -> float | None:
    optics = session.bench.get("optics", {})
    pitch = optics.get("pixel_pitch_um") if isinstance(optics, Mapping) else None
    return float(pitch) if isinstance(pitch, int | float) else None
