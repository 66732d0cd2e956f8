"""What the Containerfile names is there, and it keeps the rules of the installation."""

import re
import shlex
import tomllib
from importlib.util import find_spec
from inspect import signature
from pathlib import Path

import pytest

from scripts.lock import OLDEST_PYTHON
from scripts.locked_extras import locked_extras
from standoff.commands.console import console

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def instructions() -> list[tuple[str, str]]:
    """Every instruction with its arguments on one line."""
    text = (ROOT / "Containerfile").read_text("utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(name, rest.strip()) for name, _, rest in (line.partition(" ") for line in lines)]


def steps(name: str) -> list[str]:
    return [rest for one, rest in instructions() if one == name]


def commands() -> list[list[str]]:
    """Every command that a RUN starts."""
    return [shlex.split(part) for rest in steps("RUN") for part in rest.split("&&")]


def test_only_known_instructions_are_there() -> None:
    known = {"FROM", "RUN", "ENV", "WORKDIR", "COPY", "USER", "EXPOSE", "ENTRYPOINT", "CMD"}
    assert {name for name, _ in instructions()} == known


def test_both_stages_have_the_python_that_the_lock_is_made_for_and_no_registry() -> None:
    images = [rest.split()[0] for rest in steps("FROM")]
    assert len(images) == 2
    assert set(images) == {f"python:{OLDEST_PYTHON}-slim-bookworm"}


def test_whoever_runs_it_is_not_root() -> None:
    names = [name for name, _ in instructions()]
    (user,) = steps("USER")
    assert user not in ("root", "0")
    assert any(words[0] == "useradd" and words[-1] == user for words in commands())
    assert names.index("USER") < names.index("ENTRYPOINT")
    assert steps("ENTRYPOINT") == ['["standoff"]']


def test_what_is_copied_is_in_the_checkout() -> None:
    copied = {
        source
        for rest in steps("COPY")
        if not rest.startswith("--from=")
        for source in rest.split()[:-1]
    }
    assert all((ROOT / source).exists() for source in copied)
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert copied >= {*wheel["packages"], *wheel["force-include"], "README.md", "LICENSE"}


def test_every_package_comes_from_the_lock() -> None:
    installs = [words for words in commands() if words[:2] == ["pip", "install"]]
    assert len(installs) == 5
    for words in installs:
        assert {"--no-deps", "--no-build-isolation"} <= set(words)
        if words[-1] == ".":  # standoff itself
            continue
        assert "--require-hashes" in words
        assert words[-1] == "extras.txt" or (ROOT / words[-1]).is_file()


def test_the_extras_and_modules_exist() -> None:
    modules = [words[words.index("-m") + 1 :] for words in commands() if "-m" in words]
    assert {words[0] for words in modules} == {"venv", "scripts.locked_extras", "standoff.warm_up"}
    assert all(find_spec(words[0]) is not None for words in modules)
    (extras,) = [words[1:-2] for words in modules if words[0] == "scripts.locked_extras"]
    assert {"console", "aravis"} <= set(extras) <= set(PROJECT["project"]["optional-dependencies"])


def test_the_port_is_the_consoles() -> None:
    assert steps("EXPOSE") == [str(signature(console).parameters["port"].default)]


def test_the_system_packages_that_gobject_is_built_with_are_those_of_set_up() -> None:
    script = (ROOT / "scripts" / "install-system-packages.sh").read_text("utf-8")
    known = set(re.findall(r'^packages="(.*)"$', script, re.MULTILINE)[0].split())
    first, second = (words for words in commands() if words[:2] == ["apt-get", "install"])
    assert {word for word in first[2:] if not word.startswith("-")} <= known
    assert "gir1.2-aravis-0.8" in second
    assert "gir1.2-aravis-0.8" in known


def test_an_extra_brings_what_its_packages_ask_for() -> None:
    names = {line.name for line in locked_extras(["console"])}
    assert {"starlette", "uvicorn", "websockets", "anyio", "h11"} <= names
    assert not names & {"pytest", "ruff", "torch", "numpy"}


def test_what_gobject_is_built_with_is_installed_before_it() -> None:
    assert "pycairo" in {line.name for line in locked_extras(["aravis"])}
    sources = [words[-1] for words in commands() if "--require-hashes" in words]
    assert sources.index("extras.txt") < sources.index("requirements/gobject.txt")


def test_an_unknown_extra_is_refused() -> None:
    with pytest.raises(KeyError):
        locked_extras(["consol"])
