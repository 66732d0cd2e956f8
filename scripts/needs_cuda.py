"""Exit status 0 if the installed torch is a build that asks for NVIDIA's libraries, else 1."""

import sys
from importlib.metadata import requires

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts.requirements_file import read


def needs_cuda(asked_for: list[str]) -> bool:
    """Whether one of the requirements is in requirements/cuda.txt and holds here."""
    cuda = {one.name for one in read("cuda")}
    asked = [Requirement(text) for text in asked_for]
    return any(
        canonicalize_name(one.name) in cuda
        and (one.marker is None or one.marker.evaluate({"extra": ""}))
        for one in asked
    )


if __name__ == "__main__":
    sys.exit(not needs_cuda(requires("torch") or []))
