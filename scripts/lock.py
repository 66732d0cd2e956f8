"""Make `requirements/` from pyproject.toml: one version of a package, the hashes of all its files.

    make lock                          # what pyproject.toml asks for, at the versions locked so far
    make lock UPGRADE=--upgrade        # at the newest versions that it allows
    make lock UPGRADE="--upgrade-package numpy"

uv resolves for every Python and machine at once and asks the package index for the hashes. torch's
builds for the processor come from elsewhere: the hash of the one that pip finds on this machine is
added to those that were locked.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import tempfile
import tomllib
from dataclasses import replace
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import NormalizedName
from packaging.version import Version

from scripts.requirements_file import FOLDER, STEPS, Locked, parse, read
from scripts.torch_build import found_by_pip

ROOT = Path(__file__).parent.parent
UV = Path(sysconfig.get_path("scripts")) / "uv"
OLDEST_PYTHON = "3.11"

# torch's builds for NVIDIA's GPUs ask for these, its builds for the processor do not.
CUDA = ("cuda-", "nvidia-", "triton")

# Built from source with pycairo installed beside it.
GOBJECT = "pygobject"

TORCH = "torch"

# Extras that are not locked: what s3fs and gcsfs ask for holds back packages of others.
NOT_LOCKED = frozenset({"s3", "gs"})

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
    "full": "What all extras but s3 and gs need beside core.txt",
    "gobject": "PyGObject, which is built with what build.txt and full.txt hold",
    "torch-cpu": "torch, the build for the processor alone, where pip finds it",
    "torch": "torch, the builds of the package index, for where pip finds no other",
    "cuda": "What a build of torch for NVIDIA's GPUs needs; its builds for the processor do not",
}


def locked_extras() -> list[str]:
    """Names of the extras that the lock is for."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [name for name in project["optional-dependencies"] if name not in NOT_LOCKED]


def _resolved(output: Path, *arguments: str) -> list[Locked]:
    """What uv makes of ``arguments``; versions in ``output`` stay unless told otherwise."""
    command = [str(UV), "pip", "compile", "--universal", "--generate-hashes", "--quiet"]
    command += ["--python-version", OLDEST_PYTHON, "--no-header", "--annotation-style", "line"]
    subprocess.run([*command, "--output-file", str(output), *arguments], cwd=ROOT, check=True)
    return parse(output.read_text(encoding="utf-8"))


def _for_targets(locked: Locked) -> Locked | None:
    """Without a marker that holds on every target; None if it holds on none."""
    holds = [locked.is_for(target) for target in TARGETS]
    if not any(holds):
        return None
    if not all(holds):
        return locked
    bare = Requirement(str(locked.requirement))
    bare.marker = None
    return replace(locked, requirement=bare)


def _torch_for_the_processor(torch: Locked, before: list[Locked]) -> Locked:
    """The line of torch's build for the processor: what pip finds here, or what was locked."""
    requirement = Requirement(f"{torch.name}=={Version(torch.version).public}+cpu")
    hashes = {h for one in before if one.requirement == requirement for h in one.hashes}
    found = found_by_pip(str(requirement))
    if found is not None:
        hashes.add(found[1])
    if not hashes:
        raise LookupError(f"pip finds no build of {requirement}: name its folder, PIP_FIND_LINKS")
    return Locked(requirement=requirement, hashes=tuple(sorted(hashes)), via="standoff")


def _step_of(name: NormalizedName, build: set[NormalizedName], core: set[NormalizedName]) -> str:
    """The file that a package is in."""
    if name == GOBJECT:
        return "gobject"
    if name == TORCH:
        return "torch"
    if name.startswith(CUDA):
        return "cuda"
    if name in build:
        return "build"
    return "core" if name in core else "full"


def _lock(upgrade: list[str]) -> dict[str, list[Locked]]:
    """Every step's packages."""
    before = [one for step in STEPS if (FOLDER / f"{step}.txt").exists() for one in read(step)]
    pins = [one for one in before if Version(one.version).local is None]
    with tempfile.TemporaryDirectory() as folder:
        everything = Path(folder) / "all.txt"
        everything.write_text("".join(f"{one.requirement}\n" for one in pins), encoding="utf-8")
        extras = (word for name in locked_extras() for word in ("--extra", name))
        found = _resolved(everything, "pyproject.toml", *extras, "--group", "build", *upgrade)
        same = ("--constraint", str(everything))
        core = _resolved(Path(folder) / "core.txt", "pyproject.toml", *same)
        build = _resolved(Path(folder) / "build.txt", "--group", "build", *same)
    names = [{one.name for one in part} for part in (build, core)]
    steps: dict[str, list[Locked]] = {step: [] for step in STEPS}
    for one in found:
        kept = _for_targets(one)
        if kept is None:
            continue
        steps[_step_of(one.name, *names)].append(kept)
    (torch,) = steps["torch"]
    steps["torch-cpu"] = [_torch_for_the_processor(torch, before)]
    return steps


def main() -> None:
    """Write every file of `requirements/`."""
    FOLDER.mkdir(exist_ok=True)
    for step, packages in _lock(sys.argv[1:]).items():
        text = f"# {ABOUT[step]}.\n# Made by `make lock`; do not edit.\n"
        text += "".join(one.text() for one in packages)
        (FOLDER / f"{step}.txt").write_text(text, encoding="utf-8")
        print(f"requirements/{step}.txt: {len(packages)} lines")


if __name__ == "__main__":
    main()
