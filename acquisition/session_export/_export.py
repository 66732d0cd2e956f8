"""Export a session: whole or not at all, capture by capture."""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from acquisition.choices import ExportFormat
from acquisition.errors import ExportError
from acquisition.session import (
    Session,
    clear_parts,
    fsync_directory,
    part_of,
    refuse_capture,
)
from acquisition.session_export._source import ExportSource

_LIBRARIES: dict[ExportFormat, tuple[str, str] | None] = {
    "ome-tiff": None,
    "ome-zarr": ("zarr", "OME-Zarr"),
    "nexus": ("h5py", "NeXus"),
}
_NEW, _OLD = "new", "old"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportRequest:
    """What to write and where: a file, or a folder for OME-Zarr; what lies there is replaced."""

    format: ExportFormat
    out: Path
    provenance: Mapping[str, Any]
    scale_at: Callable[[float], float | None] = lambda _: None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSummary:
    """What was exported: captures, how many of them with a scale, and captures left out."""

    captures: int
    with_scale: int
    left_out: int


def require_exporter(format_: ExportFormat) -> None:
    """Check that the library for a format is installed."""
    needed = _LIBRARIES[format_]
    if needed is None:
        return
    module, name = needed
    try:
        import_module(module)
    except ImportError as error:
        raise ExportError(
            f'{name} needs {module} ({error}): pip install "standoff[export]"'
        ) from error


def write_export(
    session: Session, request: ExportRequest, progress: Callable[[int], None] = lambda _: None
) -> ExportSummary:
    """Write the captures of a session, neither superseded nor excluded, in another format.

    What fails, or is interrupted, leaves what was at ``request.out`` before.
    """
    if not session.records:
        raise ExportError(f"session {session.path} has no captures to export")
    require_exporter(request.format)
    source = ExportSource(
        session=session,
        provenance=request.provenance,
        scale_at=request.scale_at,
        progress=progress,
    )
    try:
        with _put_in_place(request.out) as path:
            _writer(request.format)(path, source)
    except OSError as error:
        raise ExportError(f"cannot write {request.out}: {error.strerror or error}") from error
    scales = [source.scale_px_per_mm(record) for record in source.records]
    return ExportSummary(
        captures=len(scales),
        with_scale=sum(scale is not None for scale in scales),
        left_out=sum(
            c.excluded_because is not None and not c.is_superseded for c in session.captures
        ),
    )


def _writer(format_: ExportFormat) -> Callable[[Path, ExportSource], None]:
    match format_:
        case "ome-tiff":
            from acquisition.session_export._ome import write_ome_tiff

            return write_ome_tiff
        case "ome-zarr":
            from acquisition.session_export._ome import write_ome_zarr

            return write_ome_zarr
        case "nexus":
            from acquisition.session_export._nexus import write_nexus

            return write_nexus


@contextmanager
def _put_in_place(out: Path) -> Iterator[Path]:
    """Give a path for a file or folder; at the end it takes the place of ``out``."""
    refuse_capture(out)
    hidden = f".{out.name}"
    clear_parts(out.parent, hidden)
    part = part_of(out.with_name(hidden))
    part.mkdir()
    try:
        yield part / _NEW
        _make_durable(part / _NEW)
        if out.is_dir():  # a folder is not replaced by a name alone, as a file is
            out.rename(part / _OLD)
        try:
            (part / _NEW).rename(out)
        except OSError:
            if (part / _OLD).exists():
                (part / _OLD).rename(out)
            raise
        fsync_directory(out.parent)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _make_durable(path: Path) -> None:
    """Have everything on the disk before its name is."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    for file in files:
        descriptor = os.open(file, os.O_RDWR)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
