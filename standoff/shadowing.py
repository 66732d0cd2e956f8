"""Whether a file of the user's hides one of our packages, whose names are everyday words.

Python looks for ``analysis`` in the working folder first where it was started with ``python -m``
or ``python -c``, in a notebook, or with ``PYTHONPATH``. Nothing is imported to find that out.
"""

from importlib.util import find_spec
from pathlib import Path

_OURS = Path(__file__).resolve().parents[1]
_PACKAGES = ("acquisition", "analysis", "calibration", "hil_mocks", "simulation")


class HiddenPackageError(ImportError):
    """A file or folder that is not ours would be imported in the place of one of our packages.

    ``name`` is the package's, ``path`` that of what hides it.
    """


def refuse_hidden_packages() -> None:
    """Check that our packages are the ones that an import would find.

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
