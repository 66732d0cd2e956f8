"""A data set of the benchmark's format, made by hand: every truth in it is a closed form.

Photographs are ramps or flat fields; nothing of the code under test makes a truth.
"""

import json
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

ROWS, COLS = 40, 60
NOISE = {"variance_at_black_dn2": 4.0, "variance_per_dn": 0.5}
BLACK, LEVEL = 100, 1100
"""Of flat follow-ups: the noise there is sqrt(4 + .5 * 1000) DN."""

TINY_SPOT_PX = 1.0


@dataclass
class HandMadeSet:
    """Content of a data set, written by ``write``."""

    charts: dict[str, Any] = field(default_factory=dict)
    simulation: dict[str, Any] = field(default_factory=dict)
    alignment: dict[str, Any] = field(default_factory=dict)
    changes: dict[str, Any] = field(default_factory=dict)
    things: dict[str, Any] = field(default_factory=dict)
    tasks: dict[str, list[Any]] = field(default_factory=dict)
    pictures: dict[str, NDArray[Any]] = field(default_factory=dict)

    def chart(
        self, name: str, mtf50: dict[str, float], kind: str = "edges", lens: str = "gaussian"
    ) -> None:
        """Add a chart whose contrasts are 1 less the frequency, whatever its MTF50."""
        contrasts = {f"mtf_{f}": 1 - float(f) for f in ("0.1", "0.2", "0.3", "0.4", "0.5")}
        self.charts[name] = {
            "kind": kind,
            "lens": {"kind": lens},
            "condition": "clean",
            "edges": {edge: {"mtf50": value, **contrasts} for edge, value in mtf50.items()},
        }

    def photograph(self, name: str, scene: str, kind: str = "frontal", zoom: float = 1.0) -> None:
        """Add a simulation of a ramp by its own pose: level 100 + 10 x + 3 y."""
        matrix = [[zoom, 0, 0], [0, zoom, 0], [0, 0, 1]]
        self.tasks.setdefault("simulation", []).append(
            {
                "task": name,
                "reference": f"simulation/{name}/reference.tif",
                "chart": f"simulation/{name}/chart.tif",
                "followup_shape": [ROWS, COLS],
                "homography_to_reference": matrix,
                "zoom": zoom,
                "kind": kind,
            }
        )
        self.simulation[name] = {
            "kind": kind,
            "zoom": zoom,
            "scene": scene,
            "lens": {"kind": "gaussian"},
            "condition": "clean",
        }
        self.pictures[f"simulation/{name}/reference.tif"] = ramp().astype(np.uint16)
        self.pictures[f"truth/simulation/{name}.tif"] = (16 * ramp()).astype(np.uint16)

    def pair(self, name: str, scene: str, *, related: bool = True, shift_px: float = 7.0) -> None:
        """Add a pair to align: the follow-up is shifted by this along x."""
        points = [[float(x), float(y)] for y in (0, 20, 39) for x in (0, 30, 59)]
        self.tasks.setdefault("alignment", []).append({"task": name, "followup_points": points})
        self.alignment[name] = {
            "related": related,
            "kind": "frontal" if related else "unrelated",
            "scene": scene,
            "points": [[x, y, x + shift_px, y] for x, y in points] if related else [],
        }

    def changed(
        self, name: str, scene: str, spots: list[tuple[float, float, float]], kind: str = "frontal"
    ) -> None:
        """Add a pair whose follow-up is flat; spots are of one pixel, (x, y, DN)."""
        self.tasks.setdefault("changes", []).append(
            {
                "task": name,
                "reference": f"changes/{name}/reference.tif",
                "followup": f"changes/{name}/followup.tif",
                "encoding": "linear",
                "max_level": 4095,
                "black_level": BLACK,
                "noise": NOISE,
                "homography_to_reference": np.eye(3).tolist(),
            }
        )
        self.changes[name] = {
            "changed": bool(spots),
            "kind": kind,
            "scene": scene,
            "zoom": 1.0,
            "spots": [
                {"x_px": x, "y_px": y, "sigma_px": TINY_SPOT_PX, "amplitude_dn": dn}
                for x, y, dn in spots
            ],
        }
        self.pictures[f"changes/{name}/followup.tif"] = np.full((ROWS, COLS), LEVEL, np.uint16)
        if spots:
            made = np.zeros((ROWS, COLS), np.int16)
            for x, y, dn in spots:
                made[round(y), round(x)] = round(16 * dn)
            self.pictures[f"truth/changes/{name}.tif"] = made

    def listed(
        self,
        name: str,
        scene: str,
        things: list[tuple[str, int, int]],
        kind: str = "hand",
        *,
        mirrored: bool = False,
    ) -> None:
        """Add a pair with things of 5 x 5 px about (x, y): ``(what, x, y)`` each."""
        self.tasks.setdefault("things", []).append({"task": name})
        truth: dict[str, Any] = {
            "changed": bool(things),
            "mirrored": mirrored,
            "kind": kind,
            "scene": scene,
            "things": [{"what": what} for what, _, _ in things],
        }
        if things:
            truth["labels"] = f"truth/things/{name}.tif"
            labels = np.zeros((ROWS, COLS), np.uint8)
            for number, (_, x, y) in enumerate(things, 1):
                labels[y - 2 : y + 3, x - 2 : x + 3] = number
            self.pictures[truth["labels"]] = labels
        self.things[name] = truth

    def write(self, folder: Path) -> Path:
        """Write the data set into a folder, with its manifest."""
        documents: dict[str, Any] = {"truth/psf.json": {"charts": self.charts}}
        for track, truth in (
            ("simulation", self.simulation),
            ("alignment", self.alignment),
            ("changes", self.changes),
            ("things", self.things),
        ):
            documents[f"truth/{track}.json"] = {"levels_per_dn": 16, "tasks": truth}
            documents[f"{track}/tasks.json"] = {
                "track": track,
                "tasks": self.tasks.get(track, []),
            }
        for name, document in documents.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(document))
        for name, picture in self.pictures.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            tifffile.imwrite(path, picture)
        write_manifest(folder, [*documents, *self.pictures])
        return folder


def write_manifest(folder: Path, names: list[str]) -> None:
    """Write the manifest of these files as they are."""
    files = {
        name: {
            "sha256": sha256((folder / name).read_bytes()).hexdigest(),
            "bytes": (folder / name).stat().st_size,
        }
        for name in sorted(names)
    }
    lines = "".join(f"{one['sha256']}  {name}\n" for name, one in files.items())
    (folder / "manifest.json").write_text(
        json.dumps(
            {
                "format": "standoff benchmark",
                "version": "1.0",
                "size": "tiny",
                "seed": 1,
                "made_with": {},
                "files": files,
                "sha256": sha256(lines.encode()).hexdigest(),
            }
        )
    )


def ramp() -> NDArray[np.float64]:
    """Levels 100 + 10 x + 3 y, which take no interpolation between 1/16 DN."""
    y, x = np.indices((ROWS, COLS))
    return np.asarray(100 + 10.0 * x + 3.0 * y, np.float64)


def write_json(folder: Path, name: str, document: object) -> Path:
    """Write one of a program's documents; returns its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(document))
    return folder


def write_table(folder: Path, lines: list[str], head: str = "chart,edge,mtf50") -> Path:
    """Write a program's psf.csv; returns its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "psf.csv").write_text("\n".join([head, *lines]) + "\n")
    return folder


def write_picture(folder: Path, track: str, task: str, levels: NDArray[Any]) -> Path:
    """Write one of a program's pictures as float32; returns its folder."""
    (folder / track).mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(folder / track / f"{task}.tif", levels.astype(np.float32))
    return folder


def everything(folder: Path, data: str = "data", program: str = "knows") -> tuple[Path, Path]:
    """A data set of all tracks, and the results of a program that knows the truth."""
    made, answers = HandMadeSet(), folder / program
    for chart in ("a", "b", "c"):
        made.chart(chart, {"0": 0.2, "1": 0.25})
    made.chart("blind", {"x": 0.2, "y": 0.3}, kind="photographs")
    head = "chart,edge,mtf50,mtf50_standard_error,mtf_0.1,mtf_0.3"
    lines = [
        f"{chart},{edge},{truth['mtf50']},0.001,0.9,0.7"
        for chart, one in made.charts.items()
        for edge, truth in one["edges"].items()
    ]
    write_table(answers, lines, head)
    for number in range(4):
        made.photograph(f"s{number}", f"scene{number}", zoom=1.0)
        write_picture(answers, "simulation", f"s{number}", ramp())
        made.pair(f"p{number}", f"scene{number}")
        made.pair(f"u{number}", f"scene{number}", related=False)
        made.changed(f"c{number}", f"scene{number}", [(10, 10, 20.0 + number), (40, 25, 50.0)])
        made.changed(f"n{number}", f"scene{number}", [])
        score = np.zeros((ROWS, COLS))
        score[5, 5] = 1.0
        write_picture(answers, "changes", f"n{number}", score)
        score[10, 10] = score[25, 40] = 9.0
        write_picture(answers, "changes", f"c{number}", score)
    shifted = [[1.0, 0, 7.0], [0, 1.0, 0], [0, 0, 1.0]]
    aligned = {f"p{number}": {"homography_to_reference": shifted} for number in range(4)}
    write_json(answers, "alignment.json", aligned)
    found = {f"c{number}": [[10.0, 10.0], [40.5, 25.0]] for number in range(4)}
    write_json(answers, "detections.json", found)
    return made.write(folder / data), answers
