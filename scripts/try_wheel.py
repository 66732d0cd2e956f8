"""Build the wheel, install it where nothing of the checkout is, and use it there.

    make wheel-check                              # the wheel on every Python of the classifiers
    python -m scripts.try_wheel --python 3.12     # on one
    python -m scripts.try_wheel --newest          # with the newest of what it needs, not the locked

The wheel is built with what requirements/build.txt has, from this environment. Each Python gets an
environment of its own with the locked packages of requirements/build.txt and core.txt; `pip check`
then says whether they are what the wheel asks for. An interpreter is ``python3.X`` on the PATH or
below ``~/.pyenv/versions``; one that is missing is named, and does not fail.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parent.parent
WHEELS = ROOT / "build" / "wheel"
LARGEST_WHEEL_BYTES = 4_000_000

_LIBRARY = (
    "import standoff; pair = standoff.example_photographs(); "
    "psf = standoff.GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.7); "
    "far = standoff.zoom_out(pair.nearer, 1.5, psf); "
    "assert far.shape[:2] == (293, 346), far.shape; "
    "assert 'site-packages' in standoff.__file__, standoff.__file__"
)
_WHERE = (
    "import standoff, skimage, pathlib; pair = standoff.example_photographs(); "
    "print(pathlib.Path(skimage.__file__).parent / 'data' / 'camera.png'); "
    "print(pair.nearer); print(pair.further)"
)


class _WheelError(Exception):
    """The wheel cannot be built, or does not work where it is installed."""


def pythons() -> tuple[str, ...]:
    """The Python versions of the classifiers, such as 3.11."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    last = [line.rpartition(" :: ")[2] for line in project["classifiers"] if "Python :: 3" in line]
    return tuple(version for version in last if "." in version)


def _interpreter(version: str) -> Path | None:
    """An interpreter of this version: on the PATH, or the newest below ~/.pyenv/versions."""
    kept = sorted(
        (Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"),
        key=lambda path: int(path.parent.parent.name.rpartition(".")[2]),
        reverse=True,
    )
    on_path = shutil.which(f"python{version}")
    for found in ([Path(on_path)] if on_path else []) + kept:
        told = "import sys; print('%d.%d' % sys.version_info[:2])"
        done = subprocess.run([found, "-c", told], check=False, capture_output=True, text=True)
        if done.returncode == 0 and done.stdout.strip() == version:
            return found
    return None


def build_wheel(folder: Path) -> Path:
    """Build the wheel with the build tools of this environment, and return its path."""
    shutil.rmtree(folder, ignore_errors=True)
    _run([sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check",
         "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT], ROOT)  # fmt: skip
    (wheel,) = folder.glob("standoff-*.whl")
    return wheel


def _install(wheel: Path, python: Path, folder: Path, *, is_newest: bool) -> Path:
    """Make an environment with the wheel in it, and return its folder of programs."""
    _run([python, "-m", "venv", folder], folder.parent)
    pip: list[str | Path] = [folder / "bin" / "python", "-m", "pip", "--disable-pip-version-check"]
    add = [*pip, "install", "--quiet", "--no-compile"]  # half the time; each module is, when used
    if is_newest:
        _run([*add, wheel], folder.parent)
    else:
        for step in ("build", "core"):  # what both need is in the first
            _run([*add, "--no-deps", "--require-hashes", "-r",
                 ROOT / "requirements" / f"{step}.txt"], folder.parent)  # fmt: skip
        _run([*add, "--no-deps", wheel], folder.parent)
    _run([*pip, "check"], folder.parent)
    return folder / "bin"


def _uses(programs: Path, folder: Path) -> Iterator[list[str | Path]]:
    """Command lines that each must succeed, in this order, in an empty folder."""
    python, standoff = programs / "python", programs / "standoff"
    yield [standoff, "--version"]
    yield [python, "-c", _LIBRARY]
    camera, nearer, further = _run([python, "-c", _WHERE], folder).splitlines()
    yield [standoff, "calibrate", camera, "--out", "psf.json", "--report", "psf.html"]
    yield [standoff, "simulate", nearer, "--psf", "psf.json", "--zoom", "1.5", "--out", "far.tif"]
    yield [standoff, "changes", nearer, further, "--out", "changes"]
    yield [standoff, "changes", nearer, "far.tif", "--out", "changes-far", "--json"]


def _run(command: Sequence[str | Path], folder: Path) -> str:
    """Run a command without what points it to the checkout, and return what it prints."""
    clean = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        command, cwd=folder, env=clean, check=False, capture_output=True, text=True
    )
    if done.returncode != 0:
        said = "\n".join((done.stdout + done.stderr).splitlines()[-15:])
        raise _WheelError(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{said}")
    return done.stdout


def _size_mb(folder: Path) -> float:
    """Room that the files below a folder take."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def _try_on(wheel: Path, python: Path, *, is_newest: bool) -> None:
    """Install the wheel for one interpreter, use it, and print sizes and times."""
    with TemporaryDirectory(prefix="standoff-wheel-") as name:
        folder, started = Path(name), time.perf_counter()
        programs = _install(wheel, python, folder / "venv", is_newest=is_newest)
        installed_s = time.perf_counter() - started
        print(f"{python}: {_size_mb(folder / 'venv'):.0f} MB installed in {installed_s:.0f} s")
        work = folder / "work"
        work.mkdir()
        for command in _uses(programs, work):
            started = time.perf_counter()
            _run(command, work)
            shown = " ".join([Path(command[0]).name, *map(str, command[1:3])])
            print(f"  {time.perf_counter() - started:5.1f} s  {shown[:70]}", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the wheel; 1 if it fails anywhere."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", action="append", metavar="VERSION", choices=pythons())
    parser.add_argument("--newest", action="store_true", help="do not take the locked packages")
    asked = parser.parse_args(arguments)
    status = 0
    try:
        wheel = build_wheel(WHEELS)
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB", flush=True)
        for version in asked.python or pythons():
            python = _interpreter(version)
            if python is None:
                print(f"Python {version} is not here: not tried")
                continue
            try:
                _try_on(wheel, python, is_newest=asked.newest)
            except _WheelError as error:
                print(f"Python {version}: {error}")
                status = 1
    except _WheelError as error:
        print(error)
        status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
