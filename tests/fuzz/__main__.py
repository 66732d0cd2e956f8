"""Search for crashes by the clock: ``python -m tests.fuzz --minutes 30 [NAME...]``.

Every target gets its turn with more examples each round. The input that crashed a reader is
printed by Hypothesis, kept in ``.hypothesis`` and found again at once by the next run.
"""

import argparse
import sys
import time
import traceback
import warnings

from hypothesis import settings

from tests.fuzz.test_fuzz import TARGETS

EXAMPLES_A_ROUND = 500


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a target's name")
    parser.add_argument("--minutes", type=float, default=10.0)
    given = parser.parse_args()
    targets = [t for t in TARGETS if not given.names or any(n in t.name for n in given.names)]
    if not targets:
        parser.error(f"no such target; there are: {', '.join(t.name for t in TARGETS)}")
    warnings.simplefilter("error")
    settings.register_profile("search", deadline=None, derandomize=False)
    settings.load_profile("search")
    end_s, crashed, rounds = time.monotonic() + 60 * given.minutes, set[str](), 0
    while time.monotonic() < end_s and len(crashed) < len(targets):
        for target in targets:
            if target.name in crashed or time.monotonic() >= end_s:
                continue
            print(f"{target.name} ...", flush=True)
            try:
                target.search(EXAMPLES_A_ROUND)
            except Exception:  # noqa: BLE001 - whatever it is, it is what was searched for
                crashed.add(target.name)
                traceback.print_exc()
        rounds += 1
    print(f"{rounds} rounds of {len(targets)} targets; crashed: {', '.join(crashed) or 'none'}")
    return 1 if crashed else 0


if __name__ == "__main__":
    sys.exit(main())
