"""The capture plans that an operator can choose from."""

from collections.abc import Iterable
from pathlib import Path

from acquisition.errors import PlanError
from acquisition.plan import CapturePlan, load_plan
from acquisition.untrusted import parse_toml
from standoff.errors import ApplicationError

PLAN_SCHEMA = "standoff.plan/1"


class PlanLibrary:
    """Plans by file name, in several folders; of two with the same name, the first counts.

    Parameters
    ----------
    folders
        Where to look, in this order.
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
        return parse_toml(path.read_bytes()).get("schema") == PLAN_SCHEMA
    except (OSError, ValueError):
        return False
