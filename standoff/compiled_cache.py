"""Compiled code: made ahead in other processes, and dropped where it is older than its sources.

numba caches compiled functions beside their module, and checks only that module's file to decide
whether they are out of date. A function that calls one from another module contains a copy of it,
which is not updated when the other module changes.
"""

import atexit
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

OF_THE_DEMO = (("edges", "profiles"), ("demo", "changes"))
EVERYTHING = (("edges", "profiles", "benchmark"), ("demo", "changes", "pairs"))
"""What ``standoff.warm_up`` compiles, a process each: one compiles one function at a time."""

COMPILED_PACKAGES = ("acquisition", "calibration", "simulation", "analysis", "hil_mocks")


def drop_stale_code(packages: tuple[str, ...] = COMPILED_PACKAGES) -> int:
    """Remove a package's compiled functions where any of its modules is newer; return how many.

    A folder that cannot be written is left as it is: nobody can change its sources either.
    """
    dropped = 0
    for name in packages:
        spec = find_spec(name)
        for folder in (spec.submodule_search_locations or []) if spec else []:
            dropped += _drop(Path(folder))
    return dropped


def _drop(folder: Path) -> int:
    indices = list(folder.rglob("__pycache__/*.nbi"))
    if not indices:
        return 0
    oldest = min(path.stat().st_mtime for path in indices)
    newest = max(path.stat().st_mtime for path in folder.rglob("*.py"))
    if newest < oldest:
        return 0
    dropped = 0
    for path in [*indices, *folder.rglob("__pycache__/*.nbc")]:
        try:
            path.unlink(missing_ok=True)
        except OSError:
            return dropped
        dropped += 1
    return dropped


def provide_folder(package: Path, cache: Path) -> None:
    """Let numba keep compiled functions for this process alone where no folder can be written.

    It keeps them beside their modules or among the user's cached files, and does not import a
    module where it can do neither: in a container, say, for a user without a home.

    Parameters
    ----------
    package, cache
        A folder of modules with compiled functions, and the user's cached files.
    """
    if "NUMBA_CACHE_DIR" in os.environ or _can_be_written(package) or _can_be_written(cache):
        return
    folder = mkdtemp(prefix="standoff-compiled-")
    os.environ["NUMBA_CACHE_DIR"] = folder
    atexit.register(rmtree, folder, ignore_errors=True)


def user_cache() -> Path:
    """Where numba keeps what it cannot keep beside a module."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())


def _can_be_written(folder: Path) -> bool:
    try:
        there = next(each for each in (folder, *folder.parents) if each.exists())
    except OSError:  # a folder above that may not be entered
        return False
    return os.access(there, os.W_OK | os.X_OK)


def holds_code() -> bool:
    """Whether edges were measured here before, with code that is kept."""
    kept = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(kept) if kept else Path(__file__).parents[1] / "calibration" / "edges"
    return any(folder.rglob("_likelihood._by_squares-*.nbi"))


def compile_ahead(works: tuple[tuple[str, ...], ...]) -> int:
    """Compile in a process for each group of works; return how many functions there were.

    Raises
    ------
    RuntimeError
        If one of the processes fails.
    """
    processes = [
        subprocess.Popen(  # noqa: S603 - our own program, without a shell
            [sys.executable, "-m", "standoff.warm_up", *group],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for us, who end them without a word
        )
        for group in works
    ]
    try:
        counts = [process.communicate()[0] for process in processes]
    finally:
        for process in processes:
            process.kill()  # nothing where it has ended
    for group, process in zip(works, processes, strict=True):
        if process.returncode != 0:
            raise RuntimeError(f"compiling {', '.join(group)} ahead failed")
    return sum(map(int, counts))
