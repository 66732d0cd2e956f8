"""The set's JSON documents: sorted keys, numbers of ten digits, the same on every machine."""

import json
from collections.abc import Iterable
from importlib.resources import files
from typing import Any

from hil_mocks.benchmark_set._camera_tracks import LEVELS, psf_tasks, simulation_tasks
from hil_mocks.benchmark_set._pair_tracks import alignment_tasks, change_tasks
from hil_mocks.benchmark_set._tasks import SIZES, Task
from hil_mocks.benchmark_set._things import things_tasks

FORMAT = "standoff benchmark"
VERSION = "1.1"
TRACKS = ("psf", "simulation", "alignment", "changes", "things")
_DIGITS = 10
_NEGLIGIBLE = 1e-11
"""Numbers below are what rounding left of 0."""


def benchmark_tasks(size: str, seed: int) -> list[Task]:
    """All tasks of a set, by the scenes that they show, so that each is painted once."""
    known = SIZES[size]
    tasks = [
        *psf_tasks(known, seed),
        *simulation_tasks(known, seed),
        *alignment_tasks(known, seed),
        *change_tasks(known, seed),
        *things_tasks(known, seed),
    ]
    return sorted(tasks, key=lambda task: (task.scene_name, task.track, task.name))


def document_bytes(document: object) -> bytes:
    """Return a document as the set holds it."""
    return (json.dumps(_rounded(document), indent=1, sort_keys=True) + "\n").encode("ascii")


def _rounded(value: Any) -> Any:  # noqa: ANN401 - what JSON holds
    if isinstance(value, dict):
        return {str(key): _rounded(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(each) for each in value]
    if isinstance(value, float):
        return 0.0 if abs(value) < _NEGLIGIBLE else float(f"{value:.{_DIGITS}g}")
    return value


def track_documents(
    track: str, records: Iterable[tuple[str, dict[str, Any], dict[str, Any]]]
) -> dict[str, bytes]:
    """Files of a track that list its tasks and their truth, by path.

    ``records`` has the name of each task, what it says and its truth.
    """
    ordered = sorted(records, key=lambda record: record[0])
    of_tasks = {name: truth for name, _, truth in ordered}
    key = "charts" if track == "psf" else "tasks"
    beside = LEVELS if track == "simulation" else {}
    return {
        f"{track}/tasks.json": document_bytes(
            {"track": track, "tasks": [task for _, task, _ in ordered]}
        ),
        f"truth/{track}.json": document_bytes({**beside, key: of_tasks}),
    }


def card_files(size: str, seed: int) -> dict[str, bytes]:
    """README.md and LICENSE of a set, by path."""
    here = files("hil_mocks") / "benchmark_set"
    card = (here / "card.md").read_text(encoding="utf-8")
    known = SIZES[size]
    facts = {
        "size": size,
        "seed": str(seed),
        "edge_charts": str(known.edge_charts),
        "photographs": str(known.photographs),
        "simulations": str(known.simulations),
        "alignments": str(known.alignments),
        "unrelated": str(known.unrelated),
        "changes": str(known.changes + known.deep_changes),
        "things": str(known.things + known.lone_things),
        "scenes": str(len(known.scenes)),
        "frame": "{1} x {0}".format(*known.frame),
    }
    for name, text in facts.items():
        card = card.replace("{{" + name + "}}", text)
    licence = (here / "licence.txt").read_text(encoding="utf-8")
    return {"README.md": card.encode(), "LICENSE": licence.encode()}
