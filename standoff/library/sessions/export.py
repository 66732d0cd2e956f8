"""A capture session in the formats of other programs."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from acquisition.choices import ExportFormat
from acquisition.session import Session
from acquisition.session_export import ExportRequest, export_session as exported, require_exporter
from calibration.files import read_geometry
from calibration.geometry import GeometryCalibration
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.errors import ApplicationError
from standoff.library.call import Call, Progress
from standoff.library.inputs import FilePath, opened_session, output_path, path_of

_ENDS = {
    "ome-tiff": (".tif", ".tiff"),
    "nexus": (".nxs", ".nx", ".nexus", ".h5", ".hdf5"),
}


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ExportedSession(Shown):
    """What was exported: captures, how many of them with a scale, and captures left out."""

    out: Path
    format: ExportFormat
    captures: int
    with_scale: int
    left_out: int
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the counts as ``standoff export --json`` prints them."""
        return {
            "out": str(self.out),
            "format": self.format,
            "captures": self.captures,
            "with_scale": self.with_scale,
            "left_out": self.left_out,
        }


@checked
def export_session(
    session: Session | FilePath,
    out: FilePath,
    *,
    format: ExportFormat,  # noqa: A002 - the word of the command line
    geometry: GeometryCalibration | FilePath | None = None,
    progress: Progress | None = None,
) -> ExportedSession:
    """Write a session's captures, with heights, exposures, variance and provenance, for others.

    Captures that are excluded, or were taken again, are left out. The session stays as it is.

    Parameters
    ----------
    session
        A session or its folder.
    out
        The file, or for OME-Zarr the folder; what lies there is replaced.
    format
        ``ome-zarr`` (0.5), ``ome-tiff`` (schema 2016-06) or ``nexus``.
    geometry
        Gives the scale of captures without their own: a geometry.json, or what it says.
    progress
        Who watches.

    Returns
    -------
    ExportedSession
        How many captures were written, and how many of them with a scale.

    Raises
    ------
    ApplicationError, ExportError
        If there is nothing to export, a library is not installed, or it cannot be written.
    SessionError
        If a capture is missing or is not the one that was captured.

    Examples
    --------
    >>> written = standoff.export_session("session", "session.ome.tif", format="ome-tiff")
    >>> written.captures
    6
    """
    require_exporter(format)
    path = path_of(out, "out") if format == "ome-zarr" else output_path(out, "out", _ENDS[format])
    if not path.parent.is_dir():
        raise ApplicationError(f"cannot write {path}: {path.parent} is not a folder")
    call, opened = Call("export_session", progress), opened_session(session)
    file = Path(geometry) if isinstance(geometry, str | PathLike) else None
    known = geometry if isinstance(geometry, GeometryCalibration) else None
    if file is not None:
        known = read_geometry(file)
    request = ExportRequest(
        format=format,
        out=path,
        provenance=call.provenance_of(opened, file).model_dump(mode="json"),
        scale_at=(lambda _: None) if known is None else known.scale_at,
    )
    with call.bar("exporting", len(opened.records)) as advance_to:
        done = exported(opened, request, advance_to)
    if done.left_out:
        call.note(f"{done.left_out} excluded capture(s) left out")
    if done.with_scale < done.captures:
        call.note(
            f"the scale of {done.captures - done.with_scale} capture(s) is not known, so that they "
            "are in pixels; --geometry gives it"
        )
    return ExportedSession(
        out=path,
        format=format,
        captures=done.captures,
        with_scale=done.with_scale,
        left_out=done.left_out,
        notes=call.notes,
    )
