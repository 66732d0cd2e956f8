"""Make the picture of docs/changes.md: what the report shows of the lantern that was taken away.

Run with ``python -m scripts.make_changes_picture [--folder docs/images]``.
"""

import argparse
import tempfile
from pathlib import Path

import standoff
from scripts.report_pictures import save_picture


def main() -> None:
    """Compare the photographs, and take the section with both from the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("docs/images"))
    picture = parser.parse_args().folder / "report-changes.jpg"
    photographs = standoff.example_photographs()
    found = standoff.find_changes(photographs.before, photographs.after)
    with tempfile.TemporaryDirectory() as name:
        found.write(Path(name))
        save_picture(Path(name) / "report.html", picture, section="Before and after")


if __name__ == "__main__":
    main()
