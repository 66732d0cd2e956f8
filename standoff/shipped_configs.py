"""Finds the bench files and capture plans that come with standoff."""

from pathlib import Path

from standoff.errors import ApplicationError

_PACKAGE = Path(__file__).parent


def shipped_config(name: str) -> Path:
    """Return the path of a shipped TOML file, from a checkout or from an installed wheel.

    Raises
    ------
    ApplicationError
        If the installation lacks it.
    """
    for folder in (_PACKAGE / "configs", _PACKAGE.parent / "configs"):
        if (folder / name).is_file():
            return folder / name
    raise ApplicationError(f"{name} is not in this installation; install standoff again")
