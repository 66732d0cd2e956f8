"""The capture plans that an operator can choose from."""

from collections.abc import Iterable
from os.path import lexists
from pathlib import Path

from acquisition.errors import PlanError
from acquisition.plan import CapturePlan, load_plan
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_toml
from standoff.console.plan_drafts import plan_toml
from standoff.console.session_library import is_session_name
from standoff.errors import ApplicationError
from standoff.library import make_folder, write_file

PLAN_SCHEMA = "standoff.plan/1"


class PlanLibrary:
    """Plans by file name, in several folders; of two with the same name, the first counts.

    Parameters
    ----------
    folders
        Where to look, in this order; new plans are written to the first.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = tuple(folders)

    def names(self) -> tuple[str, ...]:
        """File names without ``.toml``, in alphabetical order."""
        return tuple(sorted(self._files()))

    def load(self, name: str) -> CapturePlan:
        """Read the plan with that name.

        Raises
        ------
        ApplicationError
            If there is none.
        PlanError
            If the file is invalid.
        """
        path = self._files().get(name)
        if path is None:
            raise ApplicationError(f"there is no plan {name!r}; choose one from the list")
        return load_plan(path)

    def has(self, name: str) -> bool:
        """Whether there is a plan with that name, or another file in its place."""
        return name in self._files() or (
            bool(self._folders) and lexists(self._folders[0] / f"{name}.toml")
        )

    def save(self, name: str, plan: CapturePlan) -> Path:
        """Write a plan to the first folder, in place of an earlier one; return its path.

        Raises
        ------
        ApplicationError
            If no plan can have that name, a file that is not a plan is in its place, or it cannot
            be written.
        """
        if not is_session_name(name):
            raise ApplicationError(
                "a plan's name has only letters, digits, spaces and . _ + -, and must begin with a "
                "letter or digit"
            )
        if not self._folders:
            raise ApplicationError("the console has no folder of plans; start it with --plans")
        path = make_folder(self._folders[0]) / f"{name}.toml"
        if path.is_symlink() or (path.exists() and not _is_plan(path)):
            raise ApplicationError(f"{path} is not a plan; choose another name")
        write_file(path, plan_toml(plan).encode("utf-8"))
        return path

    def folder_of(self, plan: CapturePlan) -> Path | None:
        """Find the folder that holds a plan, from which its files are named; None if none does."""
        for path in self._files().values():
            try:
                if load_plan(path) == plan:
                    return path.parent
            except PlanError:
                continue
        return None

    def _files(self) -> dict[str, Path]:
        found: dict[str, Path] = {}
        for folder in self._folders:
            for path in sorted(folder.glob("*.toml")):
                if path.stem not in found and _is_plan(path):
                    found[path.stem] = path
        return found


def _is_plan(path: Path) -> bool:
    """Whether a TOML file claims to be a plan; its content is checked when it is loaded."""
    try:
        return parse_toml(read_regular_file(path)).get("schema") == PLAN_SCHEMA
    except (OSError, ValueError):
        return False
