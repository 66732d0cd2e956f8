"""Answers the tasks of a benchmark by one program, in the files that the scorer reads.

What is done is kept in ``journal.jsonl`` of the results, a line a task: a run that was broken off
goes on where it ended.
"""

import csv
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from acquisition.photographs import tiff_bytes
from benchmarks.peers.program import (
    CONTRAST_FREQ_CY_PER_PX,
    AlignedPoints,
    Answer,
    ChangeScore,
    Entry,
    ListedThings,
    PeerError,
    Program,
    Task,
    Track,
    tasks_of,
)

JOURNAL = "journal.jsonl"
SLOW_TASKS = 4
"""Tasks of a track that a slow program answers unless one says otherwise."""

_COLUMNS = ("mtf50", "mtf50_standard_error", *(f"mtf_{freq:g}" for freq in CONTRAST_FREQ_CY_PER_PX))


@dataclass(slots=True)
class Results:
    """The folder of one program's results."""

    folder: Path
    lines: list[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        if (journal := self.folder / JOURNAL).is_file():
            whole = journal.read_text("utf-8").split("\n")[:-1]
            self.lines = [json.loads(line) for line in whole]
            # Of a line that was broken off nothing is left.
            journal.write_text("".join(f"{line}\n" for line in whole), "utf-8")

    def of_track(self, track: Track) -> list[dict[str, Any]]:
        """Lines of one track, in the order in which they were done."""
        return [line for line in self.lines if line["track"] == track]

    def keep(self, line: dict[str, Any]) -> None:
        """Add a line to the journal at once."""
        self.lines.append(line)
        with (self.folder / JOURNAL).open("a", encoding="utf-8") as journal:
            journal.write(json.dumps(line) + "\n")

    def write_image(self, task: Task, image: np.ndarray[Any, Any]) -> None:
        """Write a map or a picture of one task."""
        path = self.folder / task.track / f"{task.name}.tif"
        path.parent.mkdir(exist_ok=True)
        part = path.with_name(f".{path.name}.part")
        part.write_bytes(tiff_bytes(image.astype(np.float32), f"{task.track} {task.name}"))
        part.replace(path)

    def write_tables(self) -> None:
        """Write what is one file a track, from the journal."""
        answered = [line for line in self.lines if "answer" in line]
        rows = [
            [line["task"], edge["edge"], *(_cell(edge[name]) for name in _COLUMNS)]
            for line in answered
            if line["track"] == "psf"
            for edge in line["answer"]
        ]
        if self.of_track("psf"):
            with (self.folder / "psf.csv").open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(
                    [["chart", "edge", *_COLUMNS], *rows]
                )
        if poses := self.of_track("alignment"):
            found = {line["task"]: line.get("answer", {"refused": True}) for line in poses}
            _write_json(self.folder / "alignment.json", found)
        if things := self.of_track("things"):
            listed = {line["task"]: line.get("answer", {"refused": True}) for line in things}
            _write_json(self.folder / "things.json", listed)
        places = {
            line["task"]: line["answer"]["places"]
            for line in answered
            if line["track"] == "changes" and line["answer"]["places"] is not None
        }
        if places:
            _write_json(self.folder / "detections.json", places)


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """How tasks are answered.

    ``limit`` is how many tasks of a track a program answers at most; None for all of them, or for
    a few where it is slow.
    """

    data: Path
    tracks: tuple[Track, ...]
    limit: int | None = None

    def run(self, program: Program, folder: Path) -> None:
        """Answer the tasks that no earlier run has answered, one by one."""
        results = Results(folder)
        about = {"name": program.name, "version": program.version, "note": program.given}
        _write_json(folder / "about.json", about)
        for track in self.tracks:
            if track in program.answers:
                self._answer(program, track, results)
                results.write_tables()

    def _answer(self, program: Program, track: Track, results: Results) -> None:
        limit = SLOW_TASKS if self.limit is None and program.is_slow else self.limit
        done = {line["task"] for line in results.of_track(track)}
        for task in tasks_of(self.data, track):
            if task.name in done:
                continue
            answered = sum("answer" in line for line in results.of_track(track))
            if limit is not None and answered >= limit:
                print(f"{program.name}, {track}: {answered} tasks, no more", flush=True)
                return
            began_s, processor_s = time.perf_counter(), time.process_time()
            line: dict[str, Any] = {"track": track, "task": task.name}
            try:
                line["answer"] = _kept(program.answers[track](task), task, results)
            except (PeerError, cv2.error) as error:
                line["reason"] = str(error)
            line["wall_s"] = round(time.perf_counter() - began_s, 3)
            line["processor_s"] = round(time.process_time() - processor_s, 3)
            results.keep(line)
            remark = f": {line['reason']}" if "reason" in line else ""
            said = f"{program.name}, {track} {task.name}, {line['wall_s']:.2f} s{remark}"
            print(said, flush=True)


def _kept(answer: Answer, task: Task, results: Results) -> Any:  # noqa: ANN401  what JSON holds
    """Write what has a file of its own; return what the journal holds of an answer."""
    if isinstance(answer, list):
        return [
            {
                "edge": each.edge,
                "mtf50": each.mtf50,
                "mtf50_standard_error": each.mtf50_standard_error,
                **dict(zip(_COLUMNS[2:], each.contrasts, strict=True)),
            }
            for each in answer
        ]
    if isinstance(answer, AlignedPoints):
        if answer.homography is not None:
            return {"homography_to_reference": answer.homography.tolist()}
        assert answer.points is not None
        return {"reference_points": answer.points.tolist()}
    if isinstance(answer, ChangeScore):
        results.write_image(task, answer.score)
        return {"places": None if answer.places is None else answer.places.tolist()}
    if isinstance(answer, ListedThings):
        return {"entries": [_entry(one) for one in answer.entries]}
    results.write_image(task, answer)
    return {"pixels": int(np.isfinite(answer).sum())}


def _entry(entry: Entry) -> dict[str, Any]:
    what = "moved" if entry.is_moved else entry.what
    place = {"x_px": entry.x_px, "y_px": entry.y_px}
    return place if what is None else {**place, "what": what}


def _cell(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.6g}"


def _write_json(path: Path, document: dict[str, Any]) -> None:
    part = path.with_name(f".{path.name}.part")
    part.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", "utf-8")
    part.replace(path)
