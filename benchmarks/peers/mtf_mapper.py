"""MTF Mapper's results, from the files that its user has let it write.

MTF Mapper runs on each chart by itself (``mtf_mapper -q CHART FOLDER/CHART``, with ``-l`` where the
chart is linear): ``FOLDER/CHART/edge_mtf_values.txt`` has a line for each edge, of which the first
numbers are that of its block, the edge's middle x and y in px, and MTF50 in cycles/px. What follows
in a line is not used.
"""

from pathlib import Path

import numpy as np

from benchmarks.peers.program import EdgeContrast, PeerError, Program, Task

EDGES_NAME = "edge_mtf_values.txt"
_NUMBERS = 4


def edges_of(path: Path) -> list[tuple[float, float, float]]:
    """Middle x and y and MTF50 of each edge that a file tells."""
    found = []
    for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            _, x_px, y_px, mtf50 = (float(word) for word in line.split()[:_NUMBERS])
        except ValueError as error:
            raise PeerError(f"{path}, line {number}: expected block, x, y and MTF50") from error
        found.append((x_px, y_px, mtf50))
    return found


def program(folder: Path) -> Program:
    """MTF Mapper as its files in a folder tell."""

    def contrasts(task: Task) -> list[EdgeContrast]:
        if task.facts["kind"] != "edges":
            raise PeerError("it needs edges")
        path = folder / task.name / EDGES_NAME
        if not path.is_file():
            raise PeerError(f"there is no {path}")
        answers = []
        found = edges_of(path)
        for edge in task.facts["edges"]:
            left, top, right, bottom = edge["roi_px"]
            middle = np.array([left + right - 1, top + bottom - 1]) / 2
            inside = [
                (float(np.hypot(x - middle[0], y - middle[1])), mtf50)
                for x, y, mtf50 in found
                if left <= x < right and top <= y < bottom
            ]
            if inside:
                answers.append(EdgeContrast(edge=edge["edge"], mtf50=min(inside)[1]))
        return answers

    return Program(
        name="mtf-mapper",
        given=f"MTF Mapper's own {EDGES_NAME} of each chart",
        answers={"psf": contrasts},
    )
