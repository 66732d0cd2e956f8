"""Every place of a command line where a file is named, and what is put there."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from random import Random

from tests.fuzz.commands.odd_documents import at_least, odd_journal, odd_json, odd_table, odd_toml
from tests.fuzz.commands.odd_file import OddFile
from tests.fuzz.commands.odd_images import odd_images
from tests.fuzz.commands.odd_places import odd_places

IMAGE_CASES, DOCUMENT_CASES = 320, 220
"""Of each slot; a few of them are drawn to be harmless."""

SOUND = "../sound"
"""The folder of sound files, from the one where a command runs."""

Cases = Callable[[bytes], Iterator[OddFile]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Slot:
    """A command, and which of the files it reads is an odd one.

    Parameters
    ----------
    name
        Of the command and the file.
    arguments
        The command line; ``@name`` is a sound file, ``BAD`` the odd one.
    file
        What the odd file takes the place of, in the folder of sound files; of a session, with
        its folder, which is copied.
    cases
        What is wrong with the odd file, given the sound one.
    beside
        Sound files that lie in the same folder as the odd one.
    leaves
        Beginnings of what a refusal may leave: the results of the other files of a folder, say.
    alters
        Beginnings of what may have changed when the command has done its work.
    takes_again
        Beginnings of what may also have changed where a journal does not name a capture.
    notes_odd_files
        Whether the command goes on without an odd file, after a note.
    takes
        Names of the odd places that are sound here: a folder where one may be named, nothing
        where the file may be missing.
    """

    name: str
    arguments: tuple[str, ...]
    file: str
    cases: Cases
    beside: tuple[str, ...] = ()
    leaves: tuple[str, ...] = ()
    alters: tuple[str, ...] = ()
    takes_again: tuple[str, ...] = ()
    notes_odd_files: bool = False
    takes: tuple[str, ...] = ()

    def odd_files(self, sound: Path) -> list[OddFile]:
        """The cases, given the folder of sound files: one of each kind, and a draw of the others.

        The draw differs from slot to slot, so that all slots together see all cases.
        """
        places = [
            replace(place, is_refused=place.is_refused and place.name not in self.takes)
            for place in odd_places()
        ]
        found = [*places, *self.cases((sound / self.file).read_bytes())]
        Random(self.name).shuffle(found)
        first = {case.kind: case for case in reversed(found)}
        others = [case for case in found if first[case.kind] is not case]
        count = IMAGE_CASES if self.cases is images else DOCUMENT_CASES
        return [*first.values(), *others][: max(count, len(first))]

    def command(self, odd: OddFile | None, sound: Path, work: Path) -> list[str]:
        """Put the file (the sound one for None) into an empty folder; return the command line."""
        target = work / self.file
        folder = Path(self.file).parts[0]
        if folder != self.file:
            shutil.copytree(sound / folder, work / folder)
        for name in self.beside:
            shutil.copy(sound / name, work / name)
        if odd is None:
            if not target.exists():
                shutil.copy(sound / self.file, target)
        else:
            target.unlink(missing_ok=True)
            odd.make(target)
        return [
            self.file if word == "BAD" else f"{SOUND}/{word[1:]}" if word[0] == "@" else word
            for word in self.arguments
        ]


def images(_: bytes) -> Iterator[OddFile]:
    return iter(_every_image())


@cache
def _every_image() -> tuple[OddFile, ...]:
    return tuple(odd_images())


def _json(sound: bytes) -> Iterator[OddFile]:
    return at_least(odd_json, sound)


def _toml(sound: bytes) -> Iterator[OddFile]:
    return at_least(odd_toml, sound)


def _table(sound: bytes) -> Iterator[OddFile]:
    return at_least(odd_table, sound)


def _journal(sound: bytes) -> Iterator[OddFile]:
    return at_least(odd_journal, sound)


# They list many, and are there to show which of them cannot be read.
_LISTS = ("session list", "compare --history of a folder")

_LEAVES = {
    "detectability": ("out.sweep/",),
    "detectability of a folder": ("out",),
    "sr-pairs": ("out/",),
}
_NO_HEAD = ("nothing", "link to nothing", "link with a long name")
_SCORE = "benchmark score answers --data @benchmark --out out"
_ANSWERS = {
    f"benchmark score, {name}": f"answers/{name}"
    for name in (
        *("psf.csv", "alignment.json", "detections.json", "about.json"),
        *("simulation/s0.tif", "changes/c0.tif"),
    )
}
_TAKES = {
    "compare --history": ("folder", "link to a folder"),
    "detectability of a folder": ("nothing",),
    **dict.fromkeys(_ANSWERS, ("nothing",)),
    **dict.fromkeys(("report, psf", "report, changes", "report, pose"), ("nothing",)),
    # A head may be lost in a power cut; the next event says so in the journal and writes a new one.
    "session note, journal.head": _NO_HEAD,
    "capture, journal.head": _NO_HEAD,
}
_ALTERS = {
    "session exclude": ("taken/journal.",),
    "session note": ("taken/journal.",),
    "capture": ("taken/journal.",),
    "import": ("imported/journal.",),
}
_TAKES_AGAIN = {"capture": ("taken/captures/",), "import": ("imported/captures/",)}


def _slot(name: str, file: str, cases: Cases, line: str, *beside: str) -> Slot:
    command = name.partition(",")[0]
    return Slot(
        name=name,
        arguments=tuple(line.split()),
        file=file,
        cases=cases,
        beside=beside,
        leaves=_LEAVES.get(command, ()),
        alters=_ALTERS.get(command, ()),
        takes_again=_TAKES_AGAIN.get(command, ()),
        notes_odd_files=command in _LISTS,
        takes=_TAKES.get(name, ()),
    )


_CHANGES = "changes @near.tif @far.tif --out out"
_POSE = "pose @near.tif @far.tif --curves @curves.json --min-dprime 2"
_DETECT = "--zooms 1,1.5 --model matched --observer npw --window 9 --signal-sigma 1 --out out.json"

IMAGE_SLOTS = (
    _slot("calibrate", "edge.tif", images, "calibrate BAD --out out.json --csv e.csv"),
    _slot("lens", "edge.tif", images, "lens BAD --out out.html"),
    _slot("calibrate --method two-distance", "far.tif", images,
          "calibrate @near.tif BAD --method two-distance --zoom 1.5 --out out.json"),
    _slot("import", "edge.tif", images, "import BAD --kind edge --height-mm 100 --out out"),
    _slot("import --mean", "edge.tif", images,
          "import BAD --kind edge --height-mm 100 --mean --out out"),
    _slot("simulate", "scene.tif", images, "simulate BAD --zoom 2 --psf @psf.json --out out.tif"),
    _slot("simulate, corrected", "scene.tif", images,
          "simulate BAD --zoom 2 --model bicubic --correct @noise.json --out out.tif"),
    _slot("simulate, another pose", "scene.tif", images,
          "simulate BAD --homography @H.json --model matched --psf @psf.json --out out.tif"),
    _slot("detectability", "near.tif", images, f"detectability BAD --psf @psf.json {_DETECT}"),
    _slot("detectability of a folder", "photographs/near.tif", images,
          f"detectability photographs --psf @psf.json {_DETECT}"),
    _slot("detectability --signal", "patch.tif", images,
          f"detectability @near.tif --signal BAD --psf @psf.json "
          f"{_DETECT.replace('--signal-sigma 1 ', '')}"),
    _slot("changes", "far.tif", images, "changes @near.tif BAD --out out"),
    _slot("changes, the reference", "near.tif", images, "changes BAD @far.tif --out out"),
    _slot("changes --mask", "mask.png", images, f"{_CHANGES} --mask BAD"),
    _slot("pose", "far.tif", images, "pose @near.tif BAD --curves @curves.json --min-dprime 2"),
    _slot("pose, the reference", "near.tif", images,
          "pose BAD @far.tif --curves @curves.json --min-dprime 2"),
    _slot("pose --mask", "mask.png", images, f"{_POSE} --mask BAD"),
    _slot("sr-pairs", "scene.tif", images,
          "sr-pairs BAD --psf @psf.json --zoom 2 --crop 32 --out out"),
    _slot("export, a capture", "taken/captures/0000_edge-005_h0180.000mm.tif", images,
          "export taken --format ome-tiff --out out.ome.tif"),
    _slot("verify, a capture", "taken/captures/0000_edge-005_h0180.000mm.tif", images,
          "verify taken"),
    _slot("calibrate, a capture", "edges/captures/0000_edge-006_h0100.000mm.tif", images,
          "calibrate --session edges --out out.json"),
    *(
        _slot(name, file, images, _SCORE) for name, file in _ANSWERS.items() if ".tif" in file
    ),
    _slot("map of a noise.json", "noise_dark.tif", images,
          "simulate @scene.tif --zoom 2 --model bicubic --correct noise.json --out out.tif",
          "noise.json", "noise_flat.tif", "noise_defects.tif"),
)  # fmt: skip

DOCUMENT_SLOTS = (
    _slot("simulate --psf", "psf.json", _json,
          "simulate @scene.tif --zoom 2 --psf BAD --out out.tif"),
    _slot("simulate --homography", "H.json", _json,
          "simulate @near.tif --homography BAD --psf @psf.json --out out.tif --nearer out.png"),
    _slot("simulate --noise", "noise.json", _json,
          "simulate @scene.tif --zoom 2 --model bicubic --noise BAD --out out.tif"),
    _slot("simulate --correct", "noise.json", _json,
          "simulate @scene.tif --zoom 2 --model bicubic --correct BAD --out out.tif",
          "noise_dark.tif", "noise_flat.tif", "noise_defects.tif"),
    _slot("calibrate --noise", "noise.json", _json,
          "calibrate @edge.tif --noise BAD --out out.json"),
    _slot("calibrate --limits", "limits.toml", _toml,
          "calibrate @edge.tif --limits BAD --out out.json"),
    _slot("lens --noise", "noise.json", _json, "lens @edge.tif --noise BAD --out out.html"),
    _slot("lens --limits", "limits.toml", _toml, "lens @edge.tif --limits BAD --out out.html"),
    _slot("detectability --psf", "psf.json", _json, f"detectability @near.tif --psf BAD {_DETECT}"),
    _slot("detectability --noise", "noise.json", _json,
          f"detectability @near.tif --noise BAD --psf @psf.json {_DETECT}"),
    _slot("sr-pairs --psf", "psf.json", _json,
          "sr-pairs @scene.tif --psf BAD --zoom 2 --crop 32 --out out"),
    _slot("compare", "psf.json", _json, "compare BAD @other-psf.json"),
    _slot("compare --history", "psf.json", _json,
          "compare BAD @other-psf.json --history --report out.html"),
    _slot("compare --history of a folder", "lens/psf.json", _json, "compare lens --history"),
    _slot("limits", "curves.json", _json,
          "limits --curves BAD --min-dprime 2 --focal-length-px 900 --image-size 780x580"),
    _slot("limits --geometry", "geometry.json", _json,
          "limits --curves @curves.json --min-dprime 2 --geometry BAD"),
    _slot("export --geometry", "geometry.json", _json,
          "export @taken --format ome-tiff --out out.ome.tif --geometry BAD"),
    _slot("pose --curves", "curves.json", _json,
          "pose @near.tif @far.tif --curves BAD --min-dprime 2"),
    _slot("pose --psf", "psf.json", _json, f"{_POSE} --psf BAD"),
    _slot("pose --homography", "H.json", _json, f"{_POSE} --homography BAD"),
    _slot("pose --points", "points.csv", _table, f"{_POSE} --points BAD"),
    _slot("changes --psf", "psf.json", _json, f"{_CHANGES} --psf BAD"),
    _slot("changes --noise", "noise.json", _json, f"{_CHANGES} --psf @psf.json --noise BAD"),
    _slot("changes --homography", "H.json", _json, f"{_CHANGES} --homography BAD"),
    _slot("changes --points", "points.csv", _table, f"{_CHANGES} --points BAD"),
    _slot("capture --bench", "bench.toml", _toml,
          "capture --bench BAD --plan @plan.toml --dry-run --out out"),
    _slot("capture --plan", "plan.toml", _toml,
          "capture --bench @bench.toml --plan BAD --dry-run --out out"),
    _slot("doctor", "bench.toml", _toml, "doctor --bench BAD"),
    _slot("stage", "bench.toml", _toml, "stage status --bench BAD"),
    _slot("validate --psf", "psf.json", _json,
          "validate --session @series --psf BAD --models bicubic --out out"),
    *(
        _slot(name, file, _table if ".csv" in file else _json, _SCORE)
        for name, file in _ANSWERS.items()
        if ".tif" not in file
    ),
    *(
        _slot(f"benchmark score --data, {name}", f"benchmark/{name}", _json,
              "benchmark score @answers --data benchmark --out out")
        for name in ("manifest.json", "truth/changes.json", "alignment/tasks.json")
    ),
    *(
        _slot(f"report, {name}", f"series/results/{name}.json", _json, "report series")
        for name in ("psf", "changes", "pose")
    ),
)  # fmt: skip

_ON_SESSIONS = {
    "verify": ("taken", "verify taken"),
    "session list": ("taken", "session list ."),
    "session show": ("taken", "session show taken"),
    "session exclude": ("taken", "session exclude 0 taken --reason dust"),
    "session note": ("taken", "session note text taken"),
    "calibrate --session": ("edges", "calibrate --session edges --out out.json"),
    "lens --session": ("edges", "lens --session edges --out out.html"),
    "noise": ("noisy", "noise --session noisy --out out.json"),
    "geometry": (
        "board",
        "geometry --session board --out out.json",
    ),
    "validate": ("series", "validate --session series --psf @psf.json --models bicubic --out out"),
    "report": ("series", "report series"),
    "capture": ("taken", "capture --bench @bench.toml --plan @plan.toml --out taken --yes"),
    "import": ("imported", "import @edge.tif --kind edge --height-mm 100 --out imported"),
}

SESSION_SLOTS = tuple(
    _slot(f"{name}, {file}", f"{folder}/{file}", cases, line)
    for name, (folder, line) in _ON_SESSIONS.items()
    for file, cases in (("session.json", _json), ("journal.jsonl", _journal))
) + tuple(
    _slot(f"{name}, journal.head", "taken/journal.head", _json, _ON_SESSIONS[name][1])
    for name in ("verify", "session note", "capture")
)

SLOTS = (*IMAGE_SLOTS, *DOCUMENT_SLOTS, *SESSION_SLOTS)
