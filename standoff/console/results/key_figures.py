"""The figures of a result in one line, as far as its file tells them; junk tells none."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json
from analysis.choices import acceptance
from analysis.detection_limits import DetectionLimit, spot_sentence
from calibration.sharpness import NORMAL_95

MAX_RESULT_BYTES = 50 * 10**6
LONGEST_LINE = 400
BEST_ALIGNMENT = "followup-grid"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFigures:
    """One line of a result, and when its file was written (ISO 8601, UTC)."""

    text: str
    written_utc: str


def key_figures(kind: str, path: Path) -> KeyFigures | None:
    """Figures of the result in a file; None if there is no such file.

    Parameters
    ----------
    kind
        Such as ``"calibrate"``; a report has no figures.
    path
        JSON document of the result, read once as long as it does not change.
    """
    try:
        if path.is_symlink() or path.parent.is_symlink() or not path.is_file():
            return None
        state = path.stat()
    except OSError:
        return None
    written = datetime.fromtimestamp(state.st_mtime, UTC).isoformat(timespec="microseconds")
    text = ""
    if path.suffix == ".json" and state.st_size <= MAX_RESULT_BYTES:
        text = _line(kind, path, state.st_mtime_ns, state.st_size)
    return KeyFigures(text=text, written_utc=written.replace("+00:00", "Z"))


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


def _psf(document: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{symbol} {_with_err(document, key, err, 4)}{unit}"
        for key, err, symbol, unit in (
            ("sigma_x_px", "sigma_x_err_px", "σx", " px"),
            ("sigma_y_px", "sigma_y_err_px", "σy", " px"),
            ("rho", "rho_err", "ρ", ""),
        )
        if document.get(key) is not None
    )


def _geometry(document: Mapping[str, Any]) -> str:
    figures = (
        ("pupil_offset_mm", "pupil_offset_err_mm", "entrance pupil", " mm", 2),
        ("focal_length_px", "focal_length_err_px", "focal length", " px", 2),
        ("tilt_deg", "tilt_err_deg", "tilt", "°", 3),
    )
    told = [
        f"{name} {_with_err(document, key, err, digits)}{unit}"
        for key, err, name, unit, digits in figures
        if document.get(key) is not None and not _is_given(document, err)
    ]
    return ", ".join(told)


def _is_given(document: Mapping[str, Any], err_key: str) -> bool:
    """Whether a value was not measured: the bench file's has no error at all."""
    return document.get(err_key) == 0


def _noise(document: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name} {_with_err(document, key, f'{key}_err', digits)}{unit}"
        for key, name, unit, digits in (
            ("gain_e_per_dn", "K", " e/DN", 3),
            ("read_noise_e", "read noise", " e", 2),
            ("saturation_dn", "saturation", " DN", 0),
        )
        if document.get(key) is not None
    )


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


def _compare(document: Mapping[str, Any]) -> str:
    return str(document["sentence"])


_LINES: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "calibrate": _psf,
    "geometry": _geometry,
    "noise": _noise,
    "validate": _validation,
    "changes": _changes,
    "pose": _pose,
    "compare": _compare,
}


def _with_err(document: Mapping[str, Any], key: str, err_key: str, digits: int) -> str:
    """A value, with half its 95 % interval where the file has an error."""
    value, err = document[key], document.get(err_key)
    sure = f" ± {NORMAL_95 * err:.{digits}f}" if isinstance(err, int | float) else ""
    return f"{value:.{digits}f}{sure}"
