"""What can be computed from a session: what each result needs, its files, and its figures."""

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

from acquisition.choices import ExportFormat
from acquisition.regular_files import read_regular_file, size_text
from acquisition.session import CaptureRecord, Session
from acquisition.untrusted import parse_json
from analysis.choices import acceptance
from analysis.detection_limits import DetectionLimit, spot_sentence
from calibration.estimate import NORMAL_95
from standoff.library import RESULTS_FOLDER

MAX_RESULT_BYTES = 50 * 10**6
LONGEST_LINE = 400
BEST_ALIGNMENT = "followup-grid"
ResultKind = Literal[
    "calibrate",
    "compare",
    "geometry",
    "noise",
    "validate",
    "pose",
    "changes",
    "report",
    "verify",
    "export",
]

TEXTURED = ("texture", "chart")
FLAT_KINDS = ("flat", "dark")
PAIRS_SHOWN = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFiles:
    """Names below a session's results folder: the JSON document, and the page to open."""

    document: str
    page: str


Figure = tuple[str, str, str, int, str]
"""Name, key, key of the standard error, digits and unit."""

FIGURES: Mapping[str, Sequence[Figure]] = {
    "calibrate": (
        ("σx", "sigma_x_px", "sigma_x_err_px", 4, " px"),
        ("σy", "sigma_y_px", "sigma_y_err_px", 4, " px"),
        ("ρ", "rho", "rho_err", 4, ""),
    ),
    "geometry": (
        ("entrance pupil", "pupil_offset_mm", "pupil_offset_err_mm", 2, " mm"),
        ("focal length", "focal_length_px", "focal_length_err_px", 2, " px"),
        ("tilt", "tilt_deg", "tilt_err_deg", 3, "°"),
    ),
    "noise": (
        ("K", "gain_e_per_dn", "gain_e_per_dn_err", 3, " e/DN"),
        ("read noise", "read_noise_e", "read_noise_e_err", 2, " e"),
        ("saturation", "saturation_dn", "saturation_dn_err", 0, " DN"),
    ),
}
"""Of results that are told by their values."""

FILES: Mapping[ResultKind, ResultFiles] = {
    "calibrate": ResultFiles(document="psf.json", page="psf.html"),
    "compare": ResultFiles(document="compare.json", page=""),
    "geometry": ResultFiles(document="geometry.json", page="geometry.html"),
    "noise": ResultFiles(document="noise.json", page="noise.html"),
    "validate": ResultFiles(document="validation/validation.json", page="validation/report.html"),
    "report": ResultFiles(document="", page="report.html"),
    "verify": ResultFiles(document="verify.json", page=""),
}

EXPORTS: Mapping[ExportFormat, str] = {
    "ome-tiff": "export.ome.tif",
    "nexus": "export.nxs",
    "ome-zarr": "export.ome.zarr",
}
"""Files that a browser can fetch, by format; OME-Zarr is a folder, which it gets as a ZIP file."""

TITLES: Mapping[ResultKind, tuple[str, str, str]] = {
    "calibrate": ("PSF", "sharpness of the camera, from edges or a scene", "calibrating"),
    "compare": ("Lens", "has it moved since the last calibration?", "comparing the PSF of"),
    "geometry": (
        "Geometry",
        "scale, entrance pupil, distortion, tilt",
        "measuring the geometry of",
    ),
    "noise": ("Noise", "gain, read noise, defects", "measuring the noise of"),
    "validate": ("Validation", "simulated against captured follow-ups", "validating"),
    "pose": ("Pose", "can two captures be compared?", "judging a pose of"),
    "changes": ("Changes", "what differs between two captures", "finding changes in"),
    "report": ("Report", "the session and its results on one page", "writing the report on"),
    "verify": ("Verify", "is every file as the journal says?", "verifying"),
    "export": ("Export", "all captures in one file for other programs", "exporting"),
}
"""Title, explanation, and the job's name in front of the session's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFigures:
    """One line of a result, and when its file was written (ISO 8601, UTC)."""

    text: str
    written_utc: str


def key_figures(kind: str, path: Path) -> KeyFigures | None:
    """Figures of the result in a file, read once while it does not change; None without a file.

    They are read by their keys, as far as there are any: a file may be of another version, or junk.
    """
    try:
        if path.is_symlink() or path.parent.is_symlink() or not path.is_file():
            return None
        state = path.stat()
    except OSError:
        return None
    text = ""
    if path.suffix == ".json" and state.st_size <= MAX_RESULT_BYTES:
        text = _line(kind, path, state.st_mtime_ns, state.st_size)
    return KeyFigures(text=text, written_utc=_written_utc(state))


def _written_utc(state: os.stat_result) -> str:
    written = datetime.fromtimestamp(state.st_mtime, UTC).isoformat(timespec="microseconds")
    return written.replace("+00:00", "Z")


def read_document(path: Path) -> dict[str, Any]:
    """The JSON object in a file; empty if there is none that can be read."""
    try:
        if path.is_symlink():
            return {}
        document = parse_json(read_regular_file(path, MAX_RESULT_BYTES))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


@lru_cache(maxsize=256)
def _line(kind: str, path: Path, _changed_ns: int, _bytes: int) -> str:
    document = read_document(path)
    try:
        text = _LINES[kind](document)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
        return ""
    return text if len(text) <= LONGEST_LINE else f"{text[:LONGEST_LINE]} …"


def _values(figures: Sequence[Figure], document: Mapping[str, Any]) -> str:
    """Values with half their 95 % intervals, where the file has an error."""
    told = []
    for name, key, err_key, digits, unit in figures:
        value, err = document.get(key), document.get(err_key)
        if value is None or (err == 0 and figures is FIGURES["geometry"]):
            continue  # the geometry's error is 0 of what was not measured: the bench file's
        sure = f" ± {NORMAL_95 * err:.{digits}f}" if isinstance(err, int | float) else ""
        told.append(f"{name} {value:.{digits}f}{sure}{unit}")
    return ", ".join(told)


def _psf(document: Mapping[str, Any]) -> str:
    """Its values; one that no edge target gave is said to be so."""
    told = _values(FIGURES["calibrate"], document)
    said = BLIND.get(str(document.get("method")))
    return f"{told}; {said}" if told and said else told


BLIND = {
    "single-image": "from edges that the scene happens to have, taken for sharp",
    "two-distance": "from one scene at two distances",
}


def _verified(document: Mapping[str, Any]) -> str:
    files = document["files"]
    good = sum(one["state"] == "ok" for one in files)
    return f"{good} of {len(files)} files match the journal"


def _validation(document: Mapping[str, Any]) -> str:
    rows = [row for row in document["table_2"] if row["alignment"] == BEST_ALIGNMENT]
    best = max(rows, key=lambda row: float(row["ssim"]))
    return (
        f"{best['pairs']} pairs, closest model: {best['model']} "
        f"(SSIM {float(best['ssim']):.3f}, PSNR {float(best['psnr_db']):.1f} dB)"
    )


def _changes(document: Mapping[str, Any]) -> str:
    found, changed = len(document["changes"]), int(document["changed_px"])
    noun = "1 change" if found == 1 else f"{found or 'no'} changes"
    said = f"{noun}: {changed} of {int(document['compared_px'])} pixels"
    limit = document.get("detection_limit")
    if limit is None:
        return said
    return f"{said}; {spot_sentence(DetectionLimit.model_validate(limit))}"


def _pose(document: Mapping[str, Any]) -> str:
    verdict = acceptance(document["is_accepted"])
    sure, probability = document.get("verdict"), document.get("probability")
    if sure is not None and probability is not None:
        verdict = f"{sure} ({100 * float(probability):.0f} % that d' is enough)"
    return (
        f"{verdict}: d' {float(document['dprime_decisive']):.2f}, threshold "
        f"{float(document['min_dprime']):g}, overlap {100 * float(document['overlap']):.0f} %"
    )


_LINES: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "calibrate": _psf,
    "verify": _verified,
    "geometry": partial(_values, FIGURES["geometry"]),
    "noise": partial(_values, FIGURES["noise"]),
    "validate": _validation,
    "changes": _changes,
    "pose": _pose,
    "compare": lambda document: str(document["sentence"]),
}


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
    """Every result that a session has or could have; pairs of captures come one by one."""
    lacks = missing_for(session, has_curves=has_curves)
    found = []
    for kind, (title, explanation, _) in TITLES.items():
        files = FILES.get(kind)
        told = None
        if files is not None:  # a page without its document says nothing
            told = key_figures(kind, session.path / RESULTS_FOLDER / (files.document or files.page))
        has_page = files is not None and bool(files.page and page_path(session.path, files.page))
        found.append(
            ResultView(
                kind=kind,
                title=title,
                explanation=explanation,
                missing=lacks[kind],
                is_done=told is not None,
                is_outdated=told is not None and told.written_utc < session.changed_utc,
                figures="" if told is None else told.text,
                page=files.page if files is not None and has_page else "",
            )
        )
        if kind == "export":
            found += _exports(session)
        elif files is None:
            found += _pairs(session.path, kind)
    return tuple(found)


def missing_for(session: Session, *, has_curves: bool) -> dict[ResultKind, str]:
    """What a session lacks for each result, as a sentence; empty if nothing."""
    records = session.records
    kinds = {record.kind for record in records}
    averaged = {record.kind for record in records if record.frames_used > 1}
    scenes = sum(record.kind not in FLAT_KINDS for record in records)
    has_psf = (session.path / RESULTS_FOLDER / FILES["calibrate"].document).is_file()
    pairs = heights_of(records, TEXTURED)
    lacks: dict[ResultKind, str] = dict.fromkeys(TITLES, "")
    if not kinds & {"edge", *TEXTURED}:
        lacks["calibrate"] = "Needs captures of a slanted edge, or of a scene."
    if not has_psf:
        lacks["compare"] = "Needs the PSF of this session."
        lacks["validate"] = "Needs the PSF of this session."
    if heights_of(records, (*TEXTURED, "board")) < 2:
        lacks["geometry"] = "Needs a board, chart or texture captured at two heights or more."
    if "dark" not in averaged:
        lacks["noise"] = "Needs a dark capture: put the lens cap on."
    elif "flat" not in averaged:
        lacks["noise"] = "Needs flat captures: an evenly lit surface at several exposures."
    if pairs < 2:
        lacks["validate"] = "Needs a texture or chart captured at two heights or more."
    if not has_curves:
        lacks["pose"] = (
            "Start the console with --curves, or choose curves of d' on the page of its bench."
        )
    if not records:
        lacks["export"] = "Needs a capture."
    for kind in ("pose", "changes"):
        if not lacks[kind] and not scenes:
            lacks[kind] = "Needs a capture of a scene, such as a texture."
    return lacks


def pair_files(kind: ResultKind, name: str) -> ResultFiles:
    """Files of a comparison of two captures; ``name`` is its folder or file name."""
    if kind == "pose":
        return ResultFiles(document=f"pose/{name}.json", page=f"pose/{name}.png")
    return ResultFiles(document=f"changes/{name}/changes.json", page=f"changes/{name}/report.html")


def export_path(session: Path, name: str) -> Path | None:
    """Path of an export that is there; None for any other name. Links are not followed."""
    path = session / RESULTS_FOLDER / name
    is_whole = path.is_dir() if name == EXPORTS["ome-zarr"] else path.is_file()
    is_there = name in EXPORTS.values() and is_whole
    return path if is_there and not (path.is_symlink() or path.parent.is_symlink()) else None


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


def _exports(session: Session) -> list[ResultView]:
    """The files that were exported."""
    found = []
    for name in EXPORTS.values():
        path = export_path(session.path, name)
        try:
            written_utc = None if path is None else _written_utc(path.stat())
        except OSError:  # it was replaced meanwhile
            written_utc = None
        if path is not None and written_utc is not None:
            found.append(
                ResultView(
                    kind="export",
                    title="",
                    explanation="",
                    is_done=True,
                    is_outdated=written_utc < session.changed_utc,
                    figures=size_text(_size_bytes(path)),
                    page=name,
                    pair=name,
                )
            )
    return found


def _size_bytes(path: Path) -> int:
    return sum(each.lstat().st_size for each in (path, *path.rglob("*")) if not each.is_dir())


def heights_of(records: Iterable[CaptureRecord], kinds: tuple[str, ...]) -> int:
    """Most heights at which one target was captured in one orientation."""
    heights: dict[tuple[str, str, float], set[float]] = defaultdict(set)
    for record in records:
        if record.kind in kinds:
            heights[record.kind, record.target, record.orientation_deg].add(record.height_asked_mm)
    return max(map(len, heights.values()), default=0)
