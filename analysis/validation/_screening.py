"""Which captures of a session a validation may count, and which two are its references.

A capture that shows another target, was shaken or is out of focus is left out by name, with the
reason: a mean over all pairs would hide it.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquisition.capture import QualityFinding, check_capture
from acquisition.session import CaptureRecord, Session
from analysis.errors import AnalysisError
from analysis.validation._document import ExcludedCapture
from calibration.errors import RegistrationError
from calibration.registration import (
    Registration,
    RegistrationHints,
    RegistrationReference,
    register_images,
)
from simulation import Psf

_COMPARED_KINDS = ("texture", "chart")

_ZOOM_TOLERANCE = 0.03
"""Tolerated difference of a measured zoom from that of the heights; stages are right to 0.1 %."""

_PAIRS_FOR_PUPIL = 4
"""Pairs that determine the entrance pupil well enough to doubt one of them."""


class NothingToCompareError(AnalysisError):
    """A session has no pair of captures that can be compared.

    ``excluded`` are the captures that were left out; empty where no target was captured at two
    heights.
    """

    def __init__(self, message: str, *, excluded: tuple[ExcludedCapture, ...] = ()) -> None:
        super().__init__(message)
        self.excluded = excluded


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RegisteredPair:
    """A reference and a follow-up from further away that was aligned to it."""

    reference: CaptureRecord
    followup: CaptureRecord
    registration: Registration


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Screening:
    """Pairs to compare, in order of target, reference and height, and excluded captures.

    ``remarks`` are what should be known of captures that count.
    """

    pairs: tuple[RegisteredPair, ...]
    excluded: tuple[ExcludedCapture, ...]
    remarks: tuple[str, ...] = ()


def series_of(session: Session) -> list[list[CaptureRecord]]:
    """Captures of each textured target and orientation, from the nearest to the furthest."""
    series: dict[tuple[str, str, float], list[CaptureRecord]] = defaultdict(list)
    for record in session.records:
        if record.kind in _COMPARED_KINDS:
            series[record.kind, record.target, record.orientation_deg].append(record)
    ordered = (sorted(records, key=lambda r: r.height_mm) for records in series.values())
    return [records for records in ordered if records[-1].height_mm > records[0].height_mm]


def registrations_at_most(session: Session, references: int) -> int:
    """How many pairs will be aligned if nothing has to be excluded."""
    return sum(
        max(len(records) - number, 0)
        for records in series_of(session)
        for number in range(1, references + 1)
    )


def screen(
    session: Session,
    psf: Psf,
    *,
    references: int = 2,
    progress: Callable[[int], None] = lambda _: None,
) -> Screening:
    """Choose the nearest good captures of every target as references, and align the others.

    ``session``: with captures of kind texture or chart at two heights or more. ``progress``: called
    with the number of pairs aligned so far.
    """
    series = series_of(session)
    if not series:
        raise NothingToCompareError(
            f"{session.path}: no target of kind texture or chart was captured at two heights; "
            "capture one, or import photographs with their heights"
        )
    done = _Done(progress)
    pairs: list[RegisteredPair] = []
    excluded: list[ExcludedCapture] = []
    remarks: list[str] = []
    for records in series:
        good, bad, notes = _good_captures(session, records)
        found = _screen_series(session, good, psf, references, done)
        pairs += found.pairs
        excluded += [*bad, *found.excluded]
        remarks += [*notes, *found.remarks]
    pairs, misplaced = _at_their_heights(pairs)
    excluded += misplaced
    if not pairs:
        reason = f": {excluded[0].text}" if excluded else ""
        raise NothingToCompareError(
            f"{session.path}: no pair of captures can be compared{reason}", excluded=tuple(excluded)
        )
    return Screening(pairs=tuple(pairs), excluded=tuple(excluded), remarks=tuple(remarks))


class _Done:
    """Counts alignments for the progress."""

    def __init__(self, progress: Callable[[int], None]) -> None:
        self._progress = progress
        self._count = 0

    def one_more(self) -> None:
        self._count += 1
        self._progress(self._count)


def _good_captures(
    session: Session, records: list[CaptureRecord]
) -> tuple[list[CaptureRecord], list[ExcludedCapture], list[str]]:
    good, bad, notes = [], [], []
    for record in records:
        findings = check_capture(session.load(record), records)
        faults = [f for f in findings if _is_disqualifying(f)]
        if faults:
            reason = "; ".join(f"{f.problem}: {f.text}" for f in faults)
            bad.append(ExcludedCapture.of(record, reason))
            continue
        good.append(record)
        notes += [f"capture {record.index}: {f.problem}: {f.text}" for f in findings]
    return good, bad, notes


def _is_disqualifying(finding: QualityFinding) -> bool:
    """Whether a capture has another PSF than the bench's; light alone does not change it."""
    return finding.problem == "motion" or (finding.problem == "focus" and finding.asks_retake)


def _screen_series(
    session: Session, records: list[CaptureRecord], psf: Psf, references: int, done: _Done
) -> Screening:
    pairs: list[RegisteredPair] = []
    failures: dict[int, list[str]] = {}
    excluded: list[ExcludedCapture] = []
    accepted: list[CaptureRecord] = []
    for candidate in records:
        further = [r for r in records if r.height_mm > candidate.height_mm]
        if len(accepted) == references or not further:
            break
        found, failed = _aligned(session, candidate, further, psf, done)
        if len(failed) * 2 > len(further) and len(further) > 1:
            reason = next(iter(failed.values()))
            text = f"{len(failed)} of {len(further)} further captures do not match it: {reason}"
            excluded.append(ExcludedCapture.of(candidate, text))
            continue
        accepted.append(candidate)
        pairs += found
        for index, reason in failed.items():
            failures.setdefault(index, []).append(
                f"it does not match capture {candidate.index}: {reason}"
            )
    outcasts = {index for index, reasons in failures.items() if len(reasons) == len(accepted)}
    # A reference that matches its own further captures is no outcast of the one before it.
    named = {record.index: record for record in records}
    remarks = []
    for index, reasons in failures.items():
        if any(index == one.capture for one in excluded):
            continue
        is_reference = any(index == one.index for one in accepted)
        if index in outcasts and not is_reference:
            excluded.append(ExcludedCapture.of(named[index], "; ".join(reasons)))
        else:
            remarks += [f"capture {index}: {reason}; this pair is excluded" for reason in reasons]
    return Screening(pairs=tuple(pairs), excluded=tuple(excluded), remarks=tuple(remarks))


def _aligned(
    session: Session, reference: CaptureRecord, further: list[CaptureRecord], psf: Psf, done: _Done
) -> tuple[list[RegisteredPair], dict[int, str]]:
    near = RegistrationReference.of(session.load(reference).mean_dn)
    pairs, failed = [], {}
    for record in further:
        try:
            registration = register_images(
                near,
                session.load(record).mean_dn,
                psf.gaussian,
                RegistrationHints(zoom=_expected_zoom(reference, record)),
            )
        except RegistrationError as error:
            failed[record.index] = str(error)
        else:
            pairs.append(
                RegisteredPair(reference=reference, followup=record, registration=registration)
            )
        done.one_more()
    return pairs, failed


def _expected_zoom(reference: CaptureRecord, followup: CaptureRecord) -> float | None:
    """Ratio of the heights; the entrance pupil is a few per cent of them away from the zero."""
    if reference.height_mm <= 0:
        return None
    return followup.height_mm / reference.height_mm


def _at_their_heights(
    pairs: list[RegisteredPair],
) -> tuple[list[RegisteredPair], list[ExcludedCapture]]:
    """Separate the pairs whose zoom their heights do not explain, wherever the pupil is."""
    heights = np.array([(p.reference.height_mm, p.followup.height_mm) for p in pairs]).reshape(
        -1, 2
    )
    zooms = np.array([p.registration.zoom for p in pairs])
    apart = zooms > 1.01
    if np.count_nonzero(apart) < _PAIRS_FOR_PUPIL:
        return pairs, []
    near, far = heights.T
    pupil_mm = float(np.median(((far - zooms * near)[apart]) / (zooms[apart] - 1)))
    expected = (far + pupil_mm) / (near + pupil_mm)
    kept, excluded = [], []
    for pair, zoom, fitting in zip(pairs, zooms, expected, strict=True):
        if abs(zoom / fitting - 1) <= _ZOOM_TOLERANCE:
            kept.append(pair)
            continue
        reason = (
            f"it is {zoom:.3f} times as far away as capture {pair.reference.index} according to "
            f"the images, but {fitting:.3f} times according to the heights"
        )
        excluded.append(ExcludedCapture.of(pair.followup, reason))
    return kept, excluded
