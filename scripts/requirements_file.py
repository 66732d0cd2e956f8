"""Reading and writing the locked sets in `requirements/`."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import NormalizedName, canonicalize_name

FOLDER = Path(__file__).parent.parent / "requirements"

# In the order in which they are installed; of the two of torch one is, and that for its libraries
# only if it asks for them.
STEPS = ("build", "core", "full", "gobject", "torch-cpu", "torch", "cuda")

_HASH = re.compile(r"--hash=(sha256:[0-9a-f]{64})(?= |$)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Locked:
    """One version of one package, the environments it is for and the files that are taken."""

    requirement: Requirement
    hashes: tuple[str, ...]  # sha256:..., in order
    via: str = ""  # what asks for it

    @property
    def name(self) -> NormalizedName:
        """Normalised as by PEP 503."""
        return canonicalize_name(self.requirement.name)

    @property
    def version(self) -> str:
        """The only version that the line allows."""
        (clause,) = self.requirement.specifier
        if clause.operator != "==" or clause.version.endswith(".*"):
            raise ValueError(f"not one version: {self.requirement}")
        return clause.version

    def is_for(self, environment: dict[str, str]) -> bool:
        """Whether the line's markers hold in ``environment``."""
        marker = self.requirement.marker
        return marker is None or marker.evaluate(environment)

    def with_hashes(self, more: tuple[str, ...]) -> Locked:
        """The same, with more files taken."""
        return replace(self, hashes=tuple(sorted({*self.hashes, *more})))

    def text(self) -> str:
        """The line as pip reads it, with its hashes."""
        lines = [str(self.requirement).replace("; ", " ; "), *(f"--hash={h}" for h in self.hashes)]
        return " \\\n    ".join(lines) + (f"\n    # via {self.via}" if self.via else "") + "\n"


def parse(text: str) -> list[Locked]:
    """Every line of a locked set, in order; each is one version of a package with SHA-256 sums."""
    found: list[Locked] = []
    for line in text.replace("\\\n", " ").splitlines():
        if line.strip().startswith("# via ") and found:
            found[-1] = replace(found[-1], via=line.strip().removeprefix("# via "))
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        bare, _, _ = line.partition("--hash=")
        hashes = tuple(sorted(_HASH.findall(line)))
        if len(hashes) != line.count("--hash=") or not hashes:
            raise ValueError(f"no SHA-256, or another hash: {bare.strip()}")
        locked = Locked(requirement=Requirement(bare.strip()), hashes=hashes)
        _ = locked.version
        found.append(locked)
    return found


def read(step: str) -> list[Locked]:
    """The locked set of one step of the installation."""
    return parse((FOLDER / f"{step}.txt").read_text(encoding="utf-8"))


def read_all() -> list[Locked]:
    """All that may be installed, every step."""
    return [locked for step in STEPS for locked in read(step)]
