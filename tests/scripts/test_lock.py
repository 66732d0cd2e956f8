"""The lock: one version of each package, with hashes, for every machine that it is for."""

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from scripts.lock import GOBJECT, TARGETS, locked_extras
from scripts.requirements_file import FOLDER, STEPS, Locked, parse, read, read_all
from scripts.torch_build import needs_cuda, step_for

ROOT = Path(__file__).parent.parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
OPTIONAL = {name: PYPROJECT["project"]["optional-dependencies"][name] for name in locked_extras()}

LINUX = [target for target in TARGETS if target["sys_platform"] == "linux"]
named = pytest.mark.parametrize(
    "target", LINUX, ids=lambda one: f"{one['python_full_version']}-{one['platform_machine']}"
)


# One of the two of torch is installed; this one needs the most beside it.
FOR_A_GPU = tuple(step for step in STEPS if step != "torch-cpu")


def versions(steps: tuple[str, ...], target: dict[str, str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for step in steps:
        for one in read(step):
            if one.is_for(target):
                assert one.name not in found, f"{one.name} is there twice"
                found[one.name] = one.version
    return found


def unmet(
    requirements: list[str], locked: dict[str, str], target: dict[str, str], extras: set[str]
) -> Iterator[str]:
    """Those of the requirements that hold on the target and that the lock does not meet."""
    for text in requirements:
        needs = Requirement(text)
        if needs.marker and not any(
            needs.marker.evaluate({**target, "extra": extra}) for extra in extras | {""}
        ):
            continue
        version = locked.get(canonicalize_name(needs.name))
        if version is None or not needs.specifier.contains(Version(version), prereleases=True):
            yield f"{text}, locked {version}"


@named
def test_the_lock_meets_what_pyproject_asks_for(target: dict[str, str]) -> None:
    core = versions(("build", "core"), target)
    assert not list(unmet(PYPROJECT["project"]["dependencies"], core, target, set()))
    assert not list(unmet(PYPROJECT["build-system"]["requires"], core, target, set()))
    full = versions(FOR_A_GPU, target)
    for extra, requirements in OPTIONAL.items():
        assert not list(unmet(requirements, full, target, set())), extra
    build = versions(("build",), target)
    assert not list(unmet(PYPROJECT["dependency-groups"]["build"], build, target, set()))


@pytest.mark.slow
@named
def test_the_lock_meets_what_each_package_asks_for_in_turn(target: dict[str, str]) -> None:
    locked = versions(FOR_A_GPU, target)
    packages = {canonicalize_name(one.name): one for one in distributions()}
    ours = [*PYPROJECT["project"]["dependencies"], *(r for some in OPTIONAL.values() for r in some)]
    waiting = [("standoff", "", ours)]
    seen: set[tuple[str, str]] = set()
    while waiting:
        name, extra, requirements = waiting.pop()
        if name != "torch":  # its builds ask for different things
            assert not list(unmet(requirements, locked, target, {extra})), name
        for needs in map(Requirement, requirements):
            other = canonicalize_name(needs.name)
            if needs.marker and not needs.marker.evaluate({**target, "extra": extra}):
                continue
            for asked in needs.extras | {""}:
                if other in packages and (other, asked) not in seen:
                    seen.add((other, asked))
                    waiting.append((other, asked, packages[other].requires or []))
    assert len(seen) > 100


def test_nothing_is_locked_that_no_machine_needs_and_nothing_with_an_idle_marker() -> None:
    for one in read_all():
        holds = [one.is_for(target) for target in TARGETS]
        assert any(holds), one.requirement
        assert one.requirement.marker is None or not all(holds), one.requirement


def test_every_line_is_one_version_with_sha256_hashes_and_no_address() -> None:
    for step in STEPS:
        text = (FOLDER / f"{step}.txt").read_text(encoding="utf-8")
        lines = parse(text)
        assert lines
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", h) for one in lines for h in one.hashes)
        assert "://" not in text
        assert "".join(one.text() for one in lines) in text  # nothing is left out by the reader


@pytest.mark.parametrize(
    "line",
    [
        "numpy==2.4.6",
        "numpy>=2 --hash=sha256:" + 64 * "0",
        "numpy==2.* --hash=sha256:" + 64 * "0",
        "numpy==2.4.6 --hash=md5:" + 32 * "0",
        "numpy==2.4.6 --hash=sha256:" + 63 * "0",
    ],
)
def test_a_line_that_vouches_for_less_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match="numpy"):
        parse(line)


def test_torch_is_locked_as_the_builds_of_the_index_and_one_for_the_processor() -> None:
    (torch,) = read("torch")
    (for_the_processor,) = read("torch-cpu")
    assert for_the_processor.version == f"{torch.version}+cpu" == "2.13.0+cpu"
    assert len(torch.hashes) >= 24
    assert for_the_processor.hashes
    assert not set(torch.hashes) & set(for_the_processor.hashes)


def test_a_build_for_the_processor_is_taken_only_with_a_locked_hash() -> None:
    ours, other = "sha256:" + 64 * "a", "sha256:" + 64 * "b"
    locked = Locked(requirement=Requirement("torch==2.13.0+cpu"), hashes=(ours,))
    assert step_for(locked, ("2.13.0+cpu", ours)) == "torch-cpu"
    assert step_for(locked, ("2.13.0+cpu", other)) == "torch"
    assert step_for(locked, None) == "torch"


def test_only_a_build_for_a_gpu_asks_for_its_libraries() -> None:
    libraries = [one.requirement.name for one in read("cuda")]
    assert "triton" in libraries
    on_linux = f"nvidia-nccl-cu13==2.29.7; sys_platform == '{sys.platform}'"
    assert needs_cuda(["filelock", on_linux])
    assert not needs_cuda(["filelock", "nvidia-nccl-cu13==2.29.7; sys_platform == 'none'"])
    assert not needs_cuda(["filelock", "jinja2", 'optree>=0.13.0; extra == "optree"'])


def test_pygobject_is_built_after_what_it_is_built_with() -> None:
    (pygobject,) = read("gobject")
    assert pygobject.name == GOBJECT
    assert STEPS.index("gobject") > STEPS.index("full") > STEPS.index("build")
    assert "pycairo" in {one.name for one in read("full")}
    assert "meson-python" in {one.name for one in read("build")}


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_setup_installs_nothing_without_a_hash_but_the_project_itself() -> None:
    done = subprocess.run(
        ["make", "-B", "-n", "setup"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    installs = [line for line in done.stdout.splitlines() if "pip " in line and " install" in line]
    assert len(installs) == len(STEPS)  # one of torch's two, and the project
    for line in installs:
        # No dependency beyond the lines, and no build environment, which pip fills unchecked.
        assert "--no-deps" in line
        assert "--no-build-isolation" in line
    assert [line for line in installs if "--require-hashes" not in line] == [
        line for line in installs if line.endswith("-e .")
    ]
    steps = [name for line in installs for name in re.findall(r"requirements/(\w+)\.txt", line)]
    # What torch_build prints stands for the two files of torch.
    assert steps == [step for step in STEPS if not step.startswith("torch")]
    (of_torch,) = (line for line in installs if "scripts.torch_build).txt" in line)
    assert "requirements/$(" in of_torch
