"""Make `requirements/` from pyproject.toml: one version of a package, the hashes of all its files.

    make lock                          # what pyproject.toml asks for, at the versions locked so far
    make lock UPGRADE=--upgrade        # at the newest versions that it allows
    make lock UPGRADE="--upgrade-package numpy"

uv resolves for every Python and machine at once and asks the package index for the hashes. Builds
of torch come from elsewhere too: the hash of the one that pip finds on this machine is added, and
hashes that were locked for the same version stay.
"""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
import tempfile
from dataclasses import replace
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import NormalizedName, canonicalize_name

from scripts.requirements_file import FOLDER, STEPS, Locked, parse, read

ROOT = Path(__file__).parent.parent
UV = Path(sysconfig.get_path("scripts")) / "uv"
OLDEST_PYTHON = "3.11"

# torch's builds for NVIDIA's GPUs ask for these, its builds for the processor do not.
CUDA = ("cuda-", "nvidia-", "triton")

# Built from source with pycairo installed beside it.
GOBJECT = "pygobject"

# Interpreters and machines that the lock is for. 3.11.2 is Debian 12's.
TARGETS = [
    {
        "python_version": ".".join(python.split(".")[:2]),
        "python_full_version": python,
        "platform_machine": machine,
        "sys_platform": system,
        "platform_system": {"linux": "Linux", "darwin": "Darwin"}[system],
        "os_name": "posix",
        "platform_python_implementation": "CPython",
        "implementation_name": "cpython",
        "extra": "",
    }
    for python in ("3.11.2", "3.11.14", "3.12.12", "3.13.9")
    for system, machine in (("linux", "x86_64"), ("linux", "aarch64"), ("darwin", "arm64"))
]

ABOUT = {
    "build": "What builds standoff and the packages that come as source",
    "core": "What standoff needs",
    "full": "What all extras need beside core.txt",
    "gobject": "PyGObject, which is built with what build.txt and full.txt hold",
    "cuda": "What a build of torch for NVIDIA's GPUs needs; its builds for the processor do not",
}


def resolved(output: Path, *arguments: str) -> list[Locked]:
    """What uv makes of ``arguments``; versions in ``output`` stay unless told otherwise."""
    command = [str(UV), "pip", "compile", "--universal", "--generate-hashes", "--quiet"]
    command += ["--python-version", OLDEST_PYTHON, "--no-header", "--annotation-style", "line"]
    subprocess.run([*command, "--output-file", str(output), *arguments], cwd=ROOT, check=True)
    return parse(output.read_text(encoding="utf-8"))


def for_targets(locked: Locked) -> Locked | None:
    """Without a marker that holds on every target; None if it holds on none."""
    holds = [locked.is_for(target) for target in TARGETS]
    if not any(holds):
        return None
    if not all(holds):
        return locked
    bare = Requirement(str(locked.requirement))
    bare.marker = None
    return replace(locked, requirement=bare)


def hash_that_pip_takes(locked: Locked) -> tuple[str, ...]:
    """The SHA-256 of the file that pip would install on this machine, where it finds one."""
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed"]
    command += ["--no-deps", "--quiet", "--report", "-", f"{locked.name}=={locked.version}"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    (item,) = json.loads(done.stdout)["install"]
    return ("sha256:" + item["download_info"]["archive_info"]["hashes"]["sha256"],)


def step_of(name: NormalizedName, build: set[NormalizedName], core: set[NormalizedName]) -> str:
    """The file that a package is in."""
    if name == GOBJECT:
        return "gobject"
    if name.startswith(CUDA):
        return "cuda"
    if name in build:
        return "build"
    return "core" if name in core else "full"


def lock(upgrade: list[str]) -> dict[str, list[Locked]]:
    """Every step's packages."""
    before = [one for step in STEPS if (FOLDER / f"{step}.txt").exists() for one in read(step)]
    with tempfile.TemporaryDirectory() as folder:
        everything = Path(folder) / "all.txt"
        everything.write_text("".join(f"{one.requirement}\n" for one in before), encoding="utf-8")
        found = resolved(everything, "pyproject.toml", "--all-extras", "--group", "build", *upgrade)
        pins = ("--constraint", str(everything))
        core = resolved(Path(folder) / "core.txt", "pyproject.toml", *pins)
        build = resolved(Path(folder) / "build.txt", "--group", "build", *pins)
    names = [{one.name for one in part} for part in (build, core)]
    steps: dict[str, list[Locked]] = {step: [] for step in STEPS}
    for one in found:
        kept = for_targets(one)
        if kept is None:
            continue
        if one.name == canonicalize_name("torch"):
            kept = kept.with_hashes(hash_that_pip_takes(one))
            for old in before:
                if (old.name, old.version) == (one.name, one.version):
                    kept = kept.with_hashes(old.hashes)
        steps[step_of(one.name, *names)].append(kept)
    return steps


def main() -> None:
    """Write every file of `requirements/`."""
    FOLDER.mkdir(exist_ok=True)
    for step, packages in lock(sys.argv[1:]).items():
        text = f"# {ABOUT[step]}.\n# Made by `make lock`; do not edit.\n"
        text += "".join(one.text() for one in packages)
        (FOLDER / f"{step}.txt").write_text(text, encoding="utf-8")
        print(f"requirements/{step}.txt: {len(packages)} lines")


if __name__ == "__main__":
    main()
