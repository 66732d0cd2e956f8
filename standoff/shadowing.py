"""Detects a user's file that hides one of our packages, whose names are everyday words.

Python looks for ``analysis`` in the working folder first if it was started with ``python -m`` or
``python -c``, in a notebook, or with ``PYTHONPATH``. The check imports nothing.
"""

from importlib.util import find_spec
from pathlib import Path

_OURS = Path(__file__).resolve().parents[1]
_PACKAGES = ("acquisition", "analysis", "calibration", "hil_mocks", "simulation")


class HiddenPackageError(ImportError):
    """A file or folder that is not ours would be imported instead of one of our packages.

    ``name`` is the package's name, ``path`` the path of the file or folder that hides it.
    """


def refuse_hidden_packages() -> None:
    """Check that an import would find our packages.

    Raises
    ------
    HiddenPackageError
        If something else is found under one of their names.
    """
    for name in _PACKAGES:
        spec = find_spec(name)
        if spec is None:
            continue
        found = (spec.submodule_search_locations or [spec.origin or ""])[0]
        if Path(found).resolve() != _OURS / name:
            raise HiddenPackageError(
                f"{found} hides standoff's own package {name!r}: rename it, or work in another "
                "folder",
                name=name,
                path=found,
            )
