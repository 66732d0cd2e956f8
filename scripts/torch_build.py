"""Which build of torch is installed, and what it needs beside it.

    python -m scripts.torch_build          # prints torch-cpu or torch: the locked set to install
    python -m scripts.torch_build --cuda   # exit status 0 if it needs NVIDIA's libraries

A build for the processor alone needs none. It is taken where pip finds one that is in the lock. pip
itself would not: of the files whose hashes are allowed it prefers those whose hashes the index
tells, and a folder of wheels tells none.
"""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import requires

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts.requirements_file import Locked, read


def found_by_pip(requirement: str) -> tuple[str, str] | None:
    """Version and SHA-256 of the file that pip would install here; None if it finds none."""
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed"]
    command += ["--no-deps", "--quiet", "--report", "-", requirement]
    done = subprocess.run(command, check=False, capture_output=True)
    if done.returncode != 0:
        return None
    (item,) = json.loads(done.stdout)["install"]
    sha256 = item["download_info"]["archive_info"]["hashes"]["sha256"]
    return item["metadata"]["version"], f"sha256:{sha256}"


def step_for(locked: Locked, found: tuple[str, str] | None) -> str:
    """The locked set to install: ``locked`` is the line of the build for the processor."""
    is_locked = found is not None and found[1] in locked.hashes
    return "torch-cpu" if is_locked else "torch"


def needs_cuda(asked_for: list[str]) -> bool:
    """Whether one of the requirements is in requirements/cuda.txt and holds here."""
    cuda = {one.name for one in read("cuda")}
    return any(
        canonicalize_name(one.name) in cuda
        and (one.marker is None or one.marker.evaluate({"extra": ""}))
        for one in map(Requirement, asked_for)
    )


def main() -> int:
    """Answer; the exit status."""
    if sys.argv[1:] == ["--cuda"]:
        return 0 if needs_cuda(requires("torch") or []) else 1
    (locked,) = read("torch-cpu")
    print(step_for(locked, found_by_pip(f"{locked.name}=={locked.version}")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
