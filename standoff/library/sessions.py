"""Capture sessions: import of photographs, checks, notes and corrections, and export."""

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from acquisition.choices import CaptureKind, ExportFormat
from acquisition.dataframe import dataframe
from acquisition.errors import SessionError
from acquisition.files import refusal_text
from acquisition.photographs import (
    Photograph as ReadPhotograph,
    PhotographFacts,
    ReadOptions,
    shared_facts,
)
from acquisition.plan import CapturePlan, parse_plan
from acquisition.printable import on_one_line
from acquisition.session import (
    MANIFEST_NAME,
    JournalEvent,
    Photograph,
    RepairReport,
    Session,
    SessionNotes,
    SessionWriter,
    VerifyReport,
    repair_session,
    verify,
)
from acquisition.session_export import ExportRequest, require_exporter, write_export
from calibration.files import read_geometry
from calibration.geometry import GeometryCalibration
from simulation.arguments import checked
from simulation.notebook import Shown, html_table
from standoff.errors import ApplicationError
from standoff.library.call import Call, FilePath, Progress, opened_session, output_path, path_of
from standoff.library.caller import login_name

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class VerifiedSession(Shown):
    """Result of checking every file of a session against its journal.

    ``repaired`` is the result of a repair made before the check; None if none was asked for.
    """

    session: Path
    report: VerifyReport
    repaired: RepairReport | None = None

    def __repr__(self) -> str:
        faults = len(self.report.faults)
        state = "sound" if self.is_ok else f"not sound, {faults} faults"
        return f"<VerifiedSession {self.session.name}: {len(self.report.files)} files, {state}>"

    def _repr_html_(self) -> str:
        rows = [(str(one["file"]), str(one["state"])) for one in self.to_json()["files"]]
        return html_table(repr(self)[1:-1], ("file", "state"), rows)

    def to_dataframe(self) -> "DataFrame":
        """Return the files as a pandas table, one row per file.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self.to_json()["files"])

    @property
    def is_ok(self) -> bool:
        """Whether there is no fault, and every file that counts is present and unchanged."""
        return self.report.is_ok

    @property
    def notes(self) -> tuple[str, ...]:
        """Anything unusual that is not a fault, and what a repair did."""
        return (*(self.repaired.remarks if self.repaired else ()), *self.report.remarks)

    def to_json(self) -> dict[str, Any]:
        """Return the checks as ``standoff verify --json`` prints them."""
        return {
            "session": str(self.session),
            "ok": self.is_ok,
            "files": [
                {"file": one.file, "state": one.state, "superseded": one.is_superseded}
                for one in self.report.files
            ],
            "faults": list(self.report.faults),
            "remarks": list(self.report.remarks),
            "repaired": None if self.repaired is None else self.repaired.to_json(),
        }


@checked
def verify_session(session: FilePath, *, repair: bool = False) -> VerifiedSession:
    """Check every file of a session against its journal.

    Parameters
    ----------
    session
        Folder of the session.
    repair
        Whether to rebuild a damaged journal first, from what can still be read of it and from the
        captures themselves; the old journal is kept.

    Returns
    -------
    VerifiedSession
        The state of each file, and what a repair did.

    Raises
    ------
    SessionError
        If the folder is not a session, or its session.json or journal is damaged.

    Examples
    --------
    >>> standoff.verify_session("session").is_ok
    True
    """
    folder = path_of(session, "session")
    repaired = repair_session(folder) if repair else None
    return VerifiedSession(session=folder, report=verify(folder), repaired=repaired)


@checked
def list_sessions(folder: FilePath) -> list[dict[str, Any]]:
    """Return plan, captures, creation time and operator of the sessions in a folder.

    Parameters
    ----------
    folder
        A folder of sessions, or the folder of one session.

    Returns
    -------
    list of dict
        One entry per session, as ``standoff session list --json`` prints it; that of a session
        that cannot be read has an ``error`` instead.

    Raises
    ------
    ApplicationError
        If ``folder`` is not a folder, or cannot be read.

    Examples
    --------
    >>> [(one["session"], one["captured"]) for one in standoff.list_sessions(".")]
    [('board', 3), ('flats', 8), ('session', 6)]
    """
    path = path_of(folder, "folder")
    if not path.is_dir():
        raise ApplicationError(f"{path} is not a folder; name the one that holds the sessions")
    try:
        folders = [path] * (path / MANIFEST_NAME).exists() + sorted(path.iterdir())
    except OSError as error:
        raise ApplicationError(f"cannot read the folder {path}: {error.strerror}") from error
    found = []
    for one in folders:
        manifest = one / MANIFEST_NAME
        try:
            if manifest.exists():
                found.append(Session(one).summary)
        except SessionError as error:
            found.append({"session": str(one), "error": str(error)})
        except OSError as error:
            found.append({"session": str(one), "error": refusal_text(manifest, error)})
    return found


@checked
def show_session(session: Session | FilePath) -> dict[str, Any]:
    """Return a session's summary, its captures, whether each is used, its notes and remarks.

    Parameters
    ----------
    session
        A session or its folder.

    Returns
    -------
    dict
        As ``standoff session show --json`` prints it.

    Raises
    ------
    SessionError
        If it cannot be read.

    Examples
    --------
    >>> shown = standoff.show_session("session")
    >>> shown["captured"]
    6
    """
    return opened_session(session).to_json()


@checked
def exclude_capture(
    session: Session | FilePath, index: int, reason: str, *, operator: str | None = None
) -> None:
    """Exclude a capture from calibration and analysis; its file stays.

    Parameters
    ----------
    session
        A session or its folder.
    index
        Index of the capture in the plan, from 0.
    reason
        Why it is excluded; recorded in the journal.
    operator
        Name of the person who decides it; the login name if None.

    Raises
    ------
    SessionError
        If the folder is not a session, the session is being written, or it has no such capture.

    Examples
    --------
    >>> standoff.exclude_capture("session", 3, "a hair on the target")
    >>> standoff.Session("session").captures[3].excluded_because
    'a hair on the target'
    """
    _notes(session, operator).exclude(index, reason)


@checked
def include_capture(
    session: Session | FilePath, index: int, reason: str = "", *, operator: str | None = None
) -> None:
    """Use an excluded capture again.

    Parameters
    ----------
    session, index, reason, operator
        As in ``exclude_capture``.

    Examples
    --------
    >>> standoff.exclude_capture("session", 3, "a hair on the target")
    >>> standoff.include_capture("session", 3)
    >>> standoff.Session("session").captures[3].excluded_because is None
    True
    """
    _notes(session, operator).include(index, reason)


@checked
def correct_height(
    session: Session | FilePath,
    indices: Sequence[int],
    height_mm: float,
    reason: str,
    *,
    operator: str | None = None,
) -> tuple[JournalEvent, ...]:
    """Correct the height of imported photographs; the journal keeps the height recorded before.

    Parameters
    ----------
    session, reason, operator
        As in ``exclude_capture``.
    indices
        Indices of the captures, from 0.
    height_mm
        The correct height of the camera, in mm.

    Returns
    -------
    tuple of JournalEvent
        The new line of the journal for each capture.

    Raises
    ------
    ValueError
        If the height is not a finite number.
    SessionError
        As ``exclude_capture``, and if the heights were read back from a stage.

    Examples
    --------
    >>> paths = ["before.tif"]
    >>> made = standoff.import_photographs(paths, "imported", kind="texture", height_mm=250)
    >>> lines = standoff.correct_height("imported", [0], 262.5, "measured with a tape")
    >>> standoff.Session("imported").records[0].height_mm
    262.5
    """
    return _notes(session, operator).correct_height(indices, height_mm, reason)


@checked
def add_note(session: Session | FilePath, text: str, *, operator: str | None = None) -> None:
    """Add a note to the session's journal.

    Parameters
    ----------
    session, operator
        As in ``exclude_capture``.
    text
        Text of the note.

    Examples
    --------
    >>> standoff.add_note("session", "the lamp was changed after capture 2")
    """
    _notes(session, operator).note(text)


@checked
def set_aside_files(
    session: Session | FilePath, reason: str, *, operator: str | None = None
) -> tuple[dict[str, str], ...]:
    """Move files that the journal does not name to the session's folder ``set-aside``.

    Such files end a capture run with an error, because they may be captures whose journal lines
    were lost. First run ``verify_session(..., repair=True)``, which adds such captures to the
    journal again.

    Parameters
    ----------
    session, operator
        As in ``exclude_capture``.
    reason
        What the files are, or why they are moved; recorded in the journal.

    Returns
    -------
    tuple of dict
        For each file, its old name (``file``), its new name (``to``) and its ``sha256``.

    Raises
    ------
    SessionError
        If the folder is not a session, the session is being written, or a file cannot be moved.

    Examples
    --------
    >>> from shutil import copy
    >>> copied = copy("before.tif", "session/captures")
    >>> [one["to"] for one in standoff.set_aside_files("session", "dropped here by mistake")]
    ['set-aside/before.tif']
    """
    return _notes(session, operator).set_aside(reason)


def _notes(session: Session | FilePath, operator: str | None) -> SessionNotes:
    path = session.path if isinstance(session, Session) else path_of(session, "session")
    return SessionNotes(path, operator=operator or login_name())


_LONGEST_TARGET = 200
"""Letters that a plan accepts."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ImportedPhotographs(Shown):
    """A session made from photographs: how many were given, and how many of them were added now."""

    session: Path
    photographs: int
    imported: int
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the counts as ``standoff import --json`` prints them."""
        return {
            "session": str(self.session),
            "imported": self.imported,
            "photographs": self.photographs,
        }


@checked
def import_photographs(
    images: Iterable[FilePath],
    out: FilePath,
    *,
    kind: CaptureKind,
    height_mm: float,
    scale_px_per_mm: float | None = None,
    operator: str | None = None,
    white_level: float | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> ImportedPhotographs:
    """Make a session from photographs taken by another program, stored as linear grey levels.

    Each photograph is a target of its own, named after its file. The same call resumes an
    interrupted import.

    Parameters
    ----------
    images
        Paths of the photographs, all of the same ``kind``.
    out
        Folder of the session.
    kind
        What the photographs show.
    height_mm
        Height of the camera in mm; 0 if it is not known: a PSF needs no height, but geometry and
        validation do.
    scale_px_per_mm
        Scale in the plane of the target, in px/mm; None if it is not known.
    operator
        Name recorded in the session; by default the login name.
    white_level
        Level, as it is stored, at which the photographs are clipped; by default the files' own.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    ImportedPhotographs
        How many photographs were given, and how many this call imported.

    Raises
    ------
    ArgumentError
        If the height or the scale is out of range.
    ApplicationError
        If two photographs have the same name, or one cannot be read.
    SessionError
        If ``out`` is another session, or cannot be written.

    Examples
    --------
    >>> paths = ["before.tif", "after.tif"]
    >>> standoff.import_photographs(paths, "imported", kind="texture", height_mm=0).imported
    2
    """
    call = Call("import_photographs", progress, reading, white_level=white_level)
    paths, folder = [path_of(image, "images") for image in images], path_of(out, "out")
    plan = _plan_of(paths, kind, height_mm)
    # A bad file is named before anything is written.
    facts = []
    for path in paths:
        read = call.inputs.photograph(path)
        read.refuse_mosaic()
        facts.append(read.facts)
    with (
        SessionWriter(
            folder,
            plan=plan,
            bench=None,
            devices=_devices(facts),
            operator=operator or login_name(),
        ) as session,
        call.bar("importing", len(paths)) as advance_to,
    ):
        pending = session.pending_entries()
        for done, entry in enumerate(pending, start=len(paths) - len(pending) + 1):
            read = call.inputs.photograph(paths[entry.index])
            if read.is_colour:
                call.note(f"{read.name}: colour stored as Rec. 601 luma")
            session.add_photograph(entry, _stored(read, scale_px_per_mm))
            advance_to(done)
    return ImportedPhotographs(
        session=folder, photographs=len(paths), imported=len(pending), notes=call.notes
    )


def _plan_of(images: Sequence[Path], kind: CaptureKind, height_mm: float) -> CapturePlan:
    twice = [name for name, count in Counter(p.name for p in images).items() if count > 1]
    if twice:
        raise ApplicationError(f"two photographs are named {twice[0]}; rename one of them")
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "imported photographs",
            "targets": [
                {
                    "kind": kind,
                    "target": _target_of(path),
                    "heights_mm": [height_mm],
                }
                for path in images
            ],
        },
        source="import",
    )


def _target_of(path: Path) -> str:
    """The name of a photograph, shortened where it is longer than that of a target may be."""
    shown = on_one_line(path.name)
    if len(shown) <= _LONGEST_TARGET:
        return shown
    digest = sha256(os.fsencode(path.name)).hexdigest()[:8]
    return f"{shown[: _LONGEST_TARGET - 9]}~{digest}"


def _devices(facts: Sequence[PhotographFacts]) -> dict[str, dict[str, object]]:
    """What all photographs say alike of their camera and lens."""
    camera: dict[str, object] = shared_facts(facts)
    keys = ("lens", "focal_length_mm", "f_number")
    lens = {key: camera.pop(key) for key in keys if key in camera}
    if "camera" in camera:
        camera["DeviceModelName"] = camera.pop("camera")
    return {name: values for name, values in (("camera", camera), ("lens", lens)) if values}


def _stored(read: ReadPhotograph, scale_px_per_mm: float | None) -> Photograph:
    grey = read.grey_dn.astype(np.float32)
    variance = read.grey_variance_dn2
    exposure_s = read.facts.exposure_s
    top_dn = read.saturation_dn
    if top_dn is None:  # a float file tells nothing, and counts none as clipped
        top_dn = float(np.nextafter(grey.max(), np.float32(np.inf)))
    return Photograph(
        image_dn=grey,
        pixel_format=f"Mono{8 * read.stored.dtype.itemsize}",
        max_level_dn=top_dn,
        exposure_us=None if exposure_s is None else 1e6 * exposure_s,
        scale_px_per_mm=scale_px_per_mm,
        variance_dn2=None if variance is None else variance.astype(np.float32),
        frames=read.frames if variance is not None else 1,
    )


_ENDS = {
    "ome-tiff": (".tif", ".tiff"),
    "nexus": (".nxs", ".nx", ".nexus", ".h5", ".hdf5"),
}


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ExportedSession(Shown):
    """Counts of an export: captures written, those of them with a scale, and captures left out."""

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
    """Write a session's captures, with heights, exposures, variance and provenance, as one file.

    For OME-Zarr it is a folder. Captures that are excluded or superseded by retakes are left out.
    The session stays as it is.

    Parameters
    ----------
    session
        A session or its folder.
    out
        Path of the file, or for OME-Zarr of the folder; anything there is replaced.
    format
        ``ome-zarr`` (0.5), ``ome-tiff`` (schema 2016-06) or ``nexus``.
    geometry
        Geometry, or the path of a geometry.json, that gives the scale of captures without their
        own.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    ExportedSession
        How many captures were written, and how many of them with a scale.

    Raises
    ------
    ApplicationError, ExportError
        If there is nothing to export, a library is not installed, or ``out`` cannot be written.
    SessionError
        If the file of a capture is missing or has changed since the capture.

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
        done = write_export(opened, request, advance_to)
    if done.left_out:
        call.note(f"{done.left_out} excluded capture(s) left out")
    if done.with_scale < done.captures:
        call.note(
            f"the scale of {done.captures - done.with_scale} capture(s) is not known, so they are "
            "in pixels; give it with --geometry"
        )
    return ExportedSession(
        out=path,
        format=format,
        captures=done.captures,
        with_scale=done.with_scale,
        left_out=done.left_out,
        notes=call.notes,
    )
