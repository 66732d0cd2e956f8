"""Every command at every place of its command line where a path belongs, in this process.

The places are found in the application: a new option is asked as soon as there is one.
"""

import codecs
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import pytest
import typer

from standoff.terminal import application, run_application
from tests.fuzz.commands.hostile_paths import (
    DATA,
    HOSTILE_PATHS,
    USAGE,
    HostilePath,
    make_hostile_places,
)
from tests.fuzz.commands.path_options import PathOption, each_command, path_options
from tests.fuzz.commands.server import load_modules
from tests.fuzz.commands.sound_files import make_sound_files
from tests.privileges import ordinary_user

pytestmark = pytest.mark.slow

HANGS_AFTER_S = 60
OPTIONS = path_options()
OF_SWEEPS = {"out", "out.sweep", "evaluation.sweep"}
"""Folders in which commands for many photographs remember those that gave nothing."""


@pytest.fixture(scope="module")
def root() -> Iterator[Path]:
    """A folder of sound files and of hostile places, which any user may enter."""
    load_modules(("console", "hil_mocks"))
    for encoding in ("ascii", "latin-1", "utf-8", "utf-16-le", "idna"):
        codecs.lookup(encoding)  # Python's own files may be out of reach of an ordinary user
    folder = Path(mkdtemp())
    folder.chmod(0o755)
    for name in ("sound", "work"):
        (folder / name).mkdir()
    make_sound_files(folder / "sound")
    for path in (folder / "sound").rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    make_hostile_places(folder / "work", {option.ending for option in OPTIONS})
    yield folder
    rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module", autouse=True)
def made_once() -> Iterator[None]:
    """Make each command from its function once: that takes longer than its refusal."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(typer.main, "get_command", cache(typer.main.get_command))
        yield


application_of = cache(lambda command: application([command]))


def status_of(words: list[str]) -> int:
    """Run a command; one that waits for ever, as those that serve, is interrupted."""
    kept = signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.alarm(HANGS_AFTER_S)
    try:
        return run_application(application_of(words[0]), words)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, kept)


def faults_of(ended: tuple[int, str, str], allowed: tuple[int, ...]) -> list[str]:
    """What is wrong with how a command ended: its status, and what it printed."""
    status, out, err = ended
    faults = []
    if status not in allowed:
        faults.append(f"status {status}")
    if status == USAGE and any(word in err for word in ("ermission", "readable", "you may not")):
        faults.append("wrong usage for what the system refuses")
    lines = err.splitlines()
    if len(lines) != 1 or not lines[0].startswith("standoff: "):
        faults.append("not one line")
    if any(not letter.isprintable() for letter in err.removesuffix("\n")):
        faults.append("not printable")
    if any(words in out + err for words in ("Traceback", "internal error", "Errno")):
        faults.append("more than a refusal")
    return faults and [*faults, err[-300:]]


@pytest.mark.parametrize("hostile", HOSTILE_PATHS, ids=[one.kind for one in HOSTILE_PATHS])
def test_a_path_that_cannot_be_used_is_refused_in_one_line_by_every_option(
    root: Path,
    hostile: HostilePath,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(root / "work")
    before = set(Path().iterdir())
    wrong: dict[PathOption, list[str]] = {}
    for option in OPTIONS:
        words = option.words(hostile.path(option.ending), root / "sound")
        if hostile.needs_ordinary_user:
            with ordinary_user():
                status = status_of(words)
        else:
            status = status_of(words)
        said = capsys.readouterr()
        allowed = (DATA, USAGE) if option.is_text else hostile.statuses
        if faults := faults_of((status, said.out, said.err), allowed):
            wrong[option] = faults
    assert not wrong, "\n".join(f"{option}: {faults}" for option, faults in wrong.items())
    left = set(Path().iterdir()) - before
    assert {path.name for path in left} <= OF_SWEEPS
    for path in left:
        rmtree(path)


def test_every_command_that_takes_a_path_is_asked() -> None:
    asked = {option.command for option in OPTIONS}
    assert asked == {name for name, _ in each_command()} - {"cameras"}
    # Some of each sort: an argument, a list, an option, a text that may name a file.
    assert {
        *("verify directory", "calibrate images", "noise --out", "session show directory"),
        *("detectability --noise", "simulate --reference-noise", "benchmark score results"),
    } <= {str(option) for option in OPTIONS}


def test_the_line_that_a_path_is_put_into_is_a_sound_one() -> None:
    commands = dict(each_command())
    for option in OPTIONS:
        words = option.words("x" + option.ending, Path("sound"))[len(option.command.split()) :]
        context = commands[option.command].make_context(option.command, words)
        assert "x" + option.ending in " ".join(map(str, context.params.values()))


def test_the_kinds_are_of_both_statuses() -> None:
    assert {hostile.statuses for hostile in HOSTILE_PATHS} == {(DATA,), (USAGE,), (DATA, USAGE)}
