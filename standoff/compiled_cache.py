"""Drops compiled code that is older than its sources.

numba caches compiled functions beside their module, and checks only that module's file to decide
whether they are out of date. A function that calls one from another module contains a copy of it,
which is not updated when the other module changes.
"""

from importlib.util import find_spec
from pathlib import Path

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
