"""The open search, by the clock: ``python -m tests.fuzz --minutes 30 [NAME...]``.

First every command is given every odd file at every place of its command line, which is counted
(``--no-commands`` leaves that out; ``--slot NAME`` does those places alone; ``--after FILE`` goes
on where the run ended whose output that is). Then, in each round, every reader is fed damaged
input, and every property test gets examples that it has not seen. What is found is printed by
Hypothesis, kept in ``.hypothesis`` and found again at once by the next run; it becomes a fixed case
beside the test, as ``make test`` draws the same examples each time.
"""

import argparse
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from hypothesis import settings

from tests.conftest import SEARCH_PROFILE
from tests.fuzz.commands.search import parts_in, search_commands
from tests.fuzz.commands.slots import SLOTS
from tests.fuzz.target import FuzzTarget
from tests.fuzz.test_fuzz import TARGETS

EXAMPLES_A_ROUND = 500
ROOT = Path(__file__).parents[2]
NOTHING_SELECTED = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    """Something that is searched: one reader, or the property tests of one module."""

    name: str
    holds: Callable[[], bool]
    """Search a round; False if something was found, which is printed."""


def readers() -> Iterator[Searched]:
    for target in TARGETS:
        yield Searched(name=target.name, holds=partial(reader_holds, target))


def property_tests() -> Iterator[Searched]:
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        if "@given" in path.read_text("utf-8"):
            name = str(path.relative_to(ROOT))
            yield Searched(name=name, holds=partial(properties_hold, name))


def reader_holds(target: FuzzTarget) -> bool:
    try:
        target.search(EXAMPLES_A_ROUND)
    except Exception:  # noqa: BLE001 - whatever it is, it is what was searched for
        traceback.print_exc()
        return False
    return True


def properties_hold(module: str) -> bool:
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-q", "--no-header", "-m", "hypothesis"),
            *("-p", "no:cacheprovider", f"--hypothesis-profile={SEARCH_PROFILE}", module),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode in NOTHING_SELECTED:
        return True
    print(done.stdout, done.stderr, sep="\n")
    return False


def commands_hold(names: list[str], earlier: Path | None = None) -> bool:
    """Give the commands whose place has such a name, or all, every case; False if one fails.

    What the output of an earlier run says was done is left out.
    """
    done_before = parts_in("" if earlier is None else earlier.read_text("utf-8"))
    slots = [slot for slot in SLOTS if not names or slot.name in names]
    cases = faults = 0
    for part in search_commands(slots, done_before):
        print(part, flush=True)
        for fault in part.faults:
            print(f"  {part.slot}: {fault}", flush=True)
        cases, faults = cases + part.cases, faults + len(part.faults)
    commands = len({slot.arguments[0] for slot in slots})
    print(f"{cases} cases at {len(slots)} places of {commands} commands; {faults} faults")
    return faults == 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a name")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--slot", action="append", default=[], help="odd files at this place")
    parser.add_argument("--after", type=Path, help="output of a run to go on with at its places")
    parser.add_argument("--no-commands", action="store_true", help="no odd files for commands")
    given = parser.parse_args()
    if given.slot:
        return 0 if commands_hold(given.slot, given.after) else 1
    is_sound = given.no_commands or bool(given.names) or commands_hold([], given.after)
    known = [*readers(), *property_tests()]
    searched = [s for s in known if not given.names or any(n in s.name for n in given.names)]
    if not searched:
        parser.error(f"no such name; there are: {', '.join(s.name for s in known)}")
    warnings.simplefilter("error")
    settings.load_profile(SEARCH_PROFILE)
    end_s, failed, rounds = time.monotonic() + 60 * given.minutes, set[str](), 0
    while time.monotonic() < end_s and len(failed) < len(searched):
        for one in searched:
            if one.name in failed or time.monotonic() >= end_s:
                continue
            print(f"{one.name} ...", flush=True)
            if not one.holds():
                failed.add(one.name)
        rounds += 1
    print(f"{rounds} rounds of {len(searched)} searches; failed: {', '.join(failed) or 'none'}")
    return 1 if failed or not is_sound else 0


if __name__ == "__main__":
    sys.exit(main())
