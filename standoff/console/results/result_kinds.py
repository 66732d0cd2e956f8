"""What can be computed from a session, what each result needs, and which files it has."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from acquisition.session import CaptureRecord, Session
from standoff.console.results.key_figures import key_figures
from standoff.library import RESULTS_FOLDER

ResultKind = Literal[
    "calibrate", "compare", "geometry", "noise", "validate", "pose", "changes", "report"
]

TEXTURED = ("texture", "chart")
FLAT_KINDS = ("flat", "dark")
PAIRS_SHOWN = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFiles:
    """Names below a session's results folder: the JSON document, and the page to open."""

    document: str
    page: str


FILES: Mapping[ResultKind, ResultFiles] = {
    "calibrate": ResultFiles(document="psf.json", page="psf.html"),
    "compare": ResultFiles(document="compare.json", page=""),
    "geometry": ResultFiles(document="geometry.json", page="geometry.html"),
    "noise": ResultFiles(document="noise.json", page="noise.html"),
    "validate": ResultFiles(document="validation/validation.json", page="validation/report.html"),
    "report": ResultFiles(document="", page="report.html"),
}

TITLES: Mapping[ResultKind, tuple[str, str, str]] = {
    "calibrate": ("PSF", "sharpness of the camera, from edges", "calibrating"),
    "compare": ("Lens", "has it moved since the last calibration?", "comparing the PSF of"),
    "geometry": (
        "Geometry",
        "scale, entrance pupil, distortion, tilt",
        "measuring the geometry of",
    ),
    "noise": ("Noise", "gain, read noise, defects", "measuring the noise of"),
    "validate": ("Validation", "simulated against captured follow-ups", "validating"),
    "pose": ("Pose", "may two captures be compared?", "judging a pose of"),
    "changes": ("Changes", "what differs between two captures", "finding changes in"),
    "report": ("Report", "the session and its results on one page", "writing the report of"),
}
"""Title, explanation, and the job's name in front of the session's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultView:
    """One result of a session: what it still lacks, or what it says and where its page is.

    ``missing`` is empty if it can be computed, ``figures`` if it was not computed yet.
    ``page`` is a name for `page_path`; ``pair`` tells which captures were compared.
    """

    kind: ResultKind
    title: str
    explanation: str
    missing: str = ""
    is_done: bool = False
    is_outdated: bool = False
    figures: str = ""
    page: str = ""
    pair: str = ""


def results_of(session: Session, *, has_curves: bool) -> tuple[ResultView, ...]:
    """Every result that a session has or could have; pairs of captures come one by one.

    Parameters
    ----------
    session
        An open session.
    has_curves
        Whether poses can be judged.
    """
    lacks = missing_for(session, has_curves=has_curves)
    found = []
    for kind, (title, explanation, _) in TITLES.items():
        files = FILES.get(kind)
        told = (
            _Told(is_done=False, figures="", written_utc="", page="")
            if files is None
            else _told(session.path, kind, files)
        )
        found.append(
            ResultView(
                kind=kind,
                title=title,
                explanation=explanation,
                missing=lacks[kind],
                is_done=told.is_done,
                is_outdated=told.is_done and told.written_utc < session.changed_utc,
                figures=told.figures,
                page=told.page,
            )
        )
        if files is None:
            found += _pairs(session.path, kind)
    return tuple(found)


def missing_for(session: Session, *, has_curves: bool) -> dict[ResultKind, str]:
    """What a session lacks for each result, as a sentence; empty if nothing."""
    records = session.records
    kinds = {record.kind for record in records}
    averaged = {record.kind for record in records if record.frames_used > 1}
    scenes = sum(record.kind not in FLAT_KINDS for record in records)
    has_psf = (session.path / RESULTS_FOLDER / FILES["calibrate"].document).is_file()
    pairs = _heights(records, TEXTURED)
    lacks: dict[ResultKind, str] = dict.fromkeys(TITLES, "")
    if "edge" not in kinds:
        lacks["calibrate"] = "Needs captures of a slanted edge."
    if not has_psf:
        lacks["compare"] = "Needs the PSF of this session."
        lacks["validate"] = "Needs the PSF of this session."
    if _heights(records, (*TEXTURED, "board")) < 2:
        lacks["geometry"] = "Needs a board, chart or texture captured at two heights or more."
    if "dark" not in averaged:
        lacks["noise"] = "Needs a dark capture: put the lens cap on."
    elif "flat" not in averaged:
        lacks["noise"] = "Needs flat captures: an evenly lit surface at several exposures."
    if pairs < 2:
        lacks["validate"] = "Needs a texture or chart captured at two heights or more."
    if not has_curves:
        lacks["pose"] = "Choose curves of d' on the bench page, or start the console with --curves."
    for kind in ("pose", "changes"):
        if not lacks[kind] and not scenes:
            lacks[kind] = "Needs a capture of a scene, such as a texture."
    return lacks


def pair_files(kind: ResultKind, name: str) -> ResultFiles:
    """Files of a comparison of two captures; ``name`` is its folder or file name."""
    if kind == "pose":
        return ResultFiles(document=f"pose/{name}.json", page=f"pose/{name}.png")
    return ResultFiles(document=f"changes/{name}/changes.json", page=f"changes/{name}/report.html")


def page_path(session: Path, page: str) -> Path | None:
    """Path of a result's page that is there; None for any other name.

    Links are not followed, and only the pages of results are found.
    """
    parts = page.split("/")
    if page not in {files.page for files in FILES.values() if files.page} and not (
        len(parts) > 1
        and all(part and not part.startswith(".") for part in parts)
        and page in {view.page for kind in ("pose", "changes") for view in _pairs(session, kind)}
    ):
        return None
    path = session / RESULTS_FOLDER
    for part in ("", *parts):
        path = path / part
        if path.is_symlink():
            return None
    return path if path.is_file() else None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Told:
    is_done: bool
    figures: str
    written_utc: str
    page: str


def _told(session: Path, kind: ResultKind, files: ResultFiles) -> _Told:
    """What the files of a result say; a page without its document says nothing."""
    folder = session / RESULTS_FOLDER
    document = key_figures(kind, folder / (files.document or files.page))
    has_page = bool(files.page) and page_path(session, files.page) is not None
    return _Told(
        is_done=document is not None,
        figures="" if document is None else document.text,
        written_utc="" if document is None else document.written_utc,
        page=files.page if has_page else "",
    )


def _pairs(session: Path, kind: ResultKind) -> list[ResultView]:
    """The comparisons of two captures that were made, the newest first."""
    folder = session / RESULTS_FOLDER / kind
    if folder.is_symlink() or folder.parent.is_symlink():
        return []
    pattern = "*.json" if kind == "pose" else "*/changes.json"
    made = []
    for path in folder.glob(pattern):
        name = path.stem if kind == "pose" else path.parent.name
        if path.is_symlink() or path.parent.is_symlink() or name.startswith("."):
            continue
        files = pair_files(kind, name)
        document = key_figures(kind, path)
        if document is not None:
            page = files.page if (session / RESULTS_FOLDER / files.page).is_file() else ""
            made.append((document.written_utc, name, document.text, page))
    title, explanation, _ = TITLES[kind]
    return [
        ResultView(
            kind=kind,
            title=title,
            explanation=explanation,
            is_done=True,
            figures=figures,
            page=page,
            pair=name,
        )
        for _, name, figures, page in sorted(made, reverse=True)[:PAIRS_SHOWN]
    ]


def _heights(records: Iterable[CaptureRecord], kinds: tuple[str, ...]) -> int:
    """Most heights at which one target was captured in one orientation."""
    heights: dict[tuple[str, str, float], set[float]] = defaultdict(set)
    for record in records:
        if record.kind in kinds:
            heights[record.kind, record.target, record.orientation_deg].add(record.height_asked_mm)
    return max(map(len, heights.values()), default=0)
