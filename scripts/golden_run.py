"""Run every command and every public function on fixed inputs, and keep what they say and write.

For changes that must not change a result. In the state before::

    python -m scripts.golden_run make FILES           # the inputs: sessions, photographs, results
    python -m scripts.golden_run run FILES BEFORE-1
    python -m scripts.golden_run run FILES BEFORE-2

and in the state after::

    python -m scripts.golden_run run FILES AFTER
    python -m scripts.golden_run compare BEFORE-1 BEFORE-2 AFTER

What differs between the two runs before (times, random names) is not compared; numbers may differ
by a billionth. The inputs are made once: the same files are read by both states.
"""

import argparse
import doctest
import hashlib
import inspect
import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from operator import attrgetter
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_POSTCARDS = "example photographs"
_CURVES = "--zooms 1,1.2,1.5 --noise 12 --contrast 120 --model matched"
_QUICK = "--zooms 1,1.5 --noise 12 --contrast 120 --tilts 0 --pairs 4 --model matched"
_COMMANDS = {
    "version": "--version",
    "calibrate": "calibrate vertical.tif horizontal.tif --out o/psf.json --report o/psf.html"
    " --csv o/edges.csv --json",
    "calibrate-text": "calibrate vertical.tif horizontal.tif --out o/psf.json",
    "calibrate-session": "calibrate --session session --out o/psf.json --json",
    "compare": "compare psf.json lens-files/psf-vertical.json --json",
    "compare-text": "compare psf.json lens-files/psf-vertical.json",
    "history": "compare --history lens-files --json",
    "geometry": "geometry --session board --out o/geometry.json --report o/geometry.html --json",
    "geometry-text": "geometry --session board --out o/geometry.json",
    "noise": "noise --session flats --out o/noise.json --report o/noise.html --json",
    "noise-text": "noise --session flats --out o/noise.json",
    "simulate": "simulate before.tif --zoom 1.5 --psf psf.json --out o/far.tif --json",
    "simulate-text": "simulate before.tif --zoom 1.5 --psf psf.json --out o/far.tif",
    "simulate-paper": "simulate before.tif --zoom 1.3 --psf psf.json --out o/far.tif --model paper"
    " --json",
    "simulate-pose": "simulate before.tif --homography H.json --psf psf.json --out o/far.tif"
    " --nearer o/nearer.png --json",
    "simulate-noise": "simulate before.tif --zoom 1.5 --psf psf.json --out o/far.tif"
    " --noise noise.json --seed 1 --exposure 0.5 --json",
    "sr-pairs": "sr-pairs photographs --psf psf.json --zoom 2 --crop 64 --out o/pairs --json",
    "change-pairs": "change-pairs photographs --psf psf.json --out o/pairs --json",
    "detectability": f"detectability photographs --psf psf.json {_CURVES} --out o/curves.json"
    " --json",
    "detectability-text": f"detectability before.tif --psf psf.json {_CURVES} --out o/curves.json",
    "evaluate": f"evaluate my_module:detector --photographs photographs --psf psf.json {_QUICK}"
    " --out o/evaluation.json --json",
    "limits": "limits --curves curves.json --min-dprime 2 --focal-length-px 964"
    " --image-size 780x580 --plot o/limits.svg --json",
    "limits-text": "limits --curves curves.json --min-dprime 2 --focal-length-px 964"
    " --image-size 780x580",
    "limits-homography": "limits --curves curves.json --min-dprime 2 --homography H.json --json",
    "pose": "pose before.tif after.tif --curves curves.json --min-dprime 2 --json",
    "pose-text": "pose before.tif after.tif --curves curves.json --min-dprime 2",
    "pose-series": "pose before.tif after --curves curves.json --min-dprime 2 --out o/poses --json",
    "changes": "changes before.tif after.tif --out o/changes --json",
    "changes-text": "changes before.tif after.tif --out o/changes",
    "changes-psf": "changes before.tif after.tif --psf psf.json --noise noise.json"
    " --limit-contrast 100 --false-discovery-rate 0.1 --out o/changes --json",
    "changes-series": "changes before.tif after --out o/changes --json",
    "changes-series-text": "changes before.tif after --out o/changes",
    "changes-colour": f"changes '{_POSTCARDS}/near.jpg' '{_POSTCARDS}/far.jpg' --out o/changes"
    " --json",
    "validate": "validate --session session --psf psf.json --out o/validation"
    " --models bicubic,paper,matched,lmmse --json",
    "validate-text": "validate --session session --psf psf.json --out o/validation"
    " --models bicubic,paper,matched",
    "plan-study": "plan-study --plan session.toml --bench bench.toml --psf psf.json"
    " --out o/study.json --json",
    "plan-study-text": "plan-study --plan session.toml --bench bench.toml --psf psf.json"
    " --out o/study.json",
    "capture": "capture --bench bench.toml --plan plan.toml --out o/session --yes --json",
    "focus": "focus --bench bench.toml --sweep --from 180 --to 260 --steps 7 --json",
    "verify": "verify session --json",
    "verify-text": "verify session",
    "report": "report session --out o/report.html --json",
    "export": "export session --out o/export.ome.tif --format ome-tiff --json",
    "import": "import vertical.tif horizontal.tif --out o/session --kind edge --height-mm 200"
    " --json",
    "session-list": "session list . --json",
    "session-show": "session show session --json",
    "session-show-text": "session show session",
    "session-exclude": "session exclude 1 session --reason dust",
    "session-note": "session note 'a note' session",
    "cameras-help": "cameras --help",
    "benchmark-make": "benchmark make --out o/benchmark --size tiny --json",
    "refused-file": "calibrate missing.tif --out o/psf.json",
    "refused-place": "simulate before.tif --zoom 1.5 --psf psf.json --out before.tif",
    "refused-option": "simulate before.tif --zoom 0.5 --psf psf.json --out o/far.tif",
    "refused-comparison": "compare lens-files/psf-vertical.json lens-files/psf-horizontal.json",
    "refused-pair": "limits --curves curves.json --min-dprime 2",
    "refused-kind": "changes before.tif psf.json --out o/changes",
    "refused-document": "simulate before.tif --zoom 1.5 --psf noise.json --out o/far.tif",
}
_WORKERS = 2
_BILLIONTH = 1e-9
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_TEXT = {".json", ".csv", ".html", ".md", ".toml", ".svg", ".txt", ".jsonl", ".xml", ""}


def make(files: Path) -> None:
    """Make the inputs."""
    import standoff
    from scripts.example_files import make_example_files

    make_example_files(files)
    pair = standoff.example_photographs()
    (files / _POSTCARDS).mkdir()
    for name, photograph in (("near", pair.nearer), ("far", pair.further)):
        shutil.copy(photograph, files / _POSTCARDS / f"{name}.jpg")


def run(files: Path, out: Path) -> None:
    """Run all that there is, each command in a copy of the inputs."""
    out.mkdir(parents=True)
    with ThreadPoolExecutor(_WORKERS) as pool:
        done = [pool.submit(_run_command, files, out, name, _COMMANDS[name]) for name in _COMMANDS]
        done += [pool.submit(_run_command, files, out, f"help-{name}", f"{name} --help")
                 for name in _names_of_commands()]  # fmt: skip
        done.append(pool.submit(_run_functions, files, out))
        for each in done:
            each.result()


def _names_of_commands() -> list[str]:
    overview = subprocess.run(
        [sys.executable, "-m", "standoff", "--help"], capture_output=True, text=True, check=True
    ).stdout
    commands = overview[overview.index("─ Commands") :]
    return re.findall(r"^│ ([a-z][a-z-]*) ", commands, re.MULTILINE)


def _run_command(files: Path, out: Path, name: str, line: str) -> None:
    folder = out / name
    work = out / ".work" / name
    shutil.copytree(files, work)
    (work / "o").mkdir()
    folder.mkdir()
    words = [sys.executable, "-m", "standoff", *shlex.split(line)]
    environment = os.environ | {"COLUMNS": "100", "PYTHONPATH": str(_ROOT), "TERM": "dumb"}
    done = subprocess.run(
        words, cwd=work, env=environment, capture_output=True, text=True, check=False
    )
    (folder / "status").write_text(f"{done.returncode}\n")
    (folder / "stdout").write_text(_neutral(done.stdout, work))
    (folder / "stderr").write_text(_neutral(done.stderr, work))
    shutil.move(work / "o", folder / "files")
    shutil.rmtree(work)


def _neutral(text: str, work: Path) -> str:
    return text.replace(str(work.resolve()), "WORK").replace(str(_ROOT), "ROOT")


def _run_functions(files: Path, out: Path) -> None:
    """Run the examples of all public functions' docstrings, in a process of their own."""
    work = out / ".work" / "functions"
    shutil.copytree(files, work)
    environment = os.environ | {"PYTHONPATH": str(_ROOT)}
    words = [sys.executable, "-m", "scripts.golden_run", "functions", str(out / "functions")]
    done = subprocess.run(words, cwd=work, env=environment, text=True, check=False)
    if done.returncode:
        raise SystemExit("the examples did not run")
    shutil.rmtree(work)


def functions(folder: Path) -> None:
    """Run the examples here, and write what each statement shows and what its names hold."""
    import standoff

    folder.mkdir(parents=True)
    parser = doctest.DocTestParser()
    here = Path.cwd()
    for name in sorted(dir(standoff)):
        if name in ("find_cameras", "load_learned", "train_detector", "capture_session"):
            continue
        about = inspect.getdoc(attrgetter(name)(standoff)) or ""
        if ">>> " not in about:
            continue
        work = here.with_name(f"functions-{name}")
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(here, work)
        os.chdir(work)
        names: dict[str, object] = {"standoff": standoff}
        test = parser.get_doctest(about, names, name, name, 0)
        shown: list[str] = []
        doctest.DocTestRunner(verbose=False).run(test, out=shown.append, clear_globs=False)
        held = {key: value for key, value in sorted(test.globs.items()) if key[:2] != "__"}
        lines = [f"{key} = {_said(value)}" for key, value in held.items()]
        (folder / f"{name}.txt").write_text(_neutral("\n".join([*shown, *lines]), work) + "\n")
        os.chdir(here)
        shutil.rmtree(work)


def _said(value: object) -> str:
    try:
        if hasattr(value, "to_json"):
            return json.dumps(value.to_json(), sort_keys=True, default=repr)
        if hasattr(value, "model_dump_json"):
            return str(value.model_dump_json())
    except (OSError, TypeError):  # a class, or a result whose files the example has removed
        return type(value).__name__
    shown = repr(value)
    return type(value).__name__ if " at 0x" in shown or "<" in shown else shown


def compare(before: Path, again: Path, after: Path) -> int:
    """Say what differs between before and after, other than what differed before anyway."""
    names = {path.relative_to(root) for root in (before, after) for path in _files(root)}
    once, twice = ({path.relative_to(root) for path in _files(root)} for root in (before, again))
    steady = once & twice
    with_random_names = {name.parent for name in once ^ twice}
    differing = 0
    for name in sorted(names):
        if name not in steady and name.parent in with_random_names:
            continue
        problem = _difference(before / name, again / name, after / name)
        if problem:
            differing += 1
            print(f"{name}: {problem}")
    print(f"{len(steady)} files compared, {differing} differ")
    return int(differing > 0)


def _files(root: Path) -> Iterator[Path]:
    return (path for path in root.rglob("*") if path.is_file() and ".work" not in path.parts)


def _difference(before: Path, again: Path, after: Path) -> str | None:
    if not after.exists():
        return "is gone"
    if not before.exists():
        return "is new"
    if before.suffix not in _TEXT:
        digests = [hashlib.sha256(path.read_bytes()).digest() for path in (before, again, after)]
        return None if digests[0] in digests[2:] or digests[0] != digests[1] else "other bytes"
    old, repeated, new = (
        path.read_text("utf-8", "replace").replace(", ", ",\n").splitlines()
        for path in (before, again, after)
    )
    for one, other, now in itertools.zip_longest(old, repeated, new, fillvalue=""):
        if one == other and not _alike(one, now):
            return f"\n    - {one:.300}\n    + {now:.300}"
    return None


def _alike(one: str, other: str) -> bool:
    if one == other:
        return True
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other):
        return False
    pairs = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
    return all(abs(float(a) - float(b)) <= _BILLIONTH * abs(float(a)) for a, b in pairs)


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["make", "run", "functions", "compare"])
    parser.add_argument("folders", type=Path, nargs="+")
    asked = parser.parse_args()
    folders = [folder.resolve() for folder in asked.folders]
    if asked.what == "compare":
        return compare(*folders)
    if asked.what == "run":
        run(*folders)
    else:
        {"make": make, "functions": functions}[asked.what](*folders)
    return 0


if __name__ == "__main__":
    sys.exit(main())
