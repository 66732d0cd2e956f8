"""Write what the commands of the tutorials print now into what the pages show.

Run with ``python -m scripts.refresh_tutorials [PAGE...]``; it takes some minutes. Numbers alone are
renewed: a line whose words have changed is for a person, and ``tests/docs`` names it.
"""

import sys
import tempfile
from pathlib import Path

from tests.docs.blocks import DoesNotRunError, blocks, terminal
from tests.docs.shown import with_its_numbers
from tests.docs.test_tutorials import TUTORIALS, fresh_checkout


def _refreshed(page: str, folder: Path) -> str:
    """The page with the numbers that its commands print in a folder."""
    with terminal(fresh_checkout(folder)) as typed:
        for block in blocks(page):
            printed = typed.run(block)
            page = page.replace(block.shown, with_its_numbers(block.shown, printed), 1)
    return page


def main() -> int:
    """Renew the pages that are named, or all tutorials."""
    for path in [Path(name) for name in sys.argv[1:]] or TUTORIALS:
        before = path.read_text("utf-8")
        try:
            with tempfile.TemporaryDirectory() as folder:
                after = _refreshed(before, Path(folder) / "standoff")
        except DoesNotRunError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            return 1
        path.write_text(after, "utf-8")
        print(f"{path.name}: {'renewed' if after != before else 'as it was'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
