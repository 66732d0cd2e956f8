"""The documentation as a site: all pages are in it, links lead somewhere, nothing is fetched."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted(page.relative_to(ROOT).with_suffix("") for page in ROOT.glob("docs/**/*.md"))


@pytest.mark.slow
def test_the_site_holds_every_page_and_fetches_nothing_from_elsewhere(tmp_path: Path) -> None:
    # A broken link, a missing picture or a page without a place in the contents is a warning.
    command = ["-q", "-W", "--keep-going", "-c", "docs", "-b", "html", ".", str(tmp_path)]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (built.returncode, built.stderr) == (0, "")
    assert 'href="README.html"' in (tmp_path / "index.html").read_text()
    first = (tmp_path / "README.html").read_text()
    assert len(PAGES) > 25
    for page in PAGES:
        assert f'href="{page}.html"' in first
    fetched = re.compile(r"""<(?:script|img|link|iframe)[^>]*(?:src|href)=["'](?:https?:)?//""")
    for path in tmp_path.rglob("*.html"):
        assert not fetched.search(path.read_text()), path.name
    for style in tmp_path.rglob("*.css"):
        assert not re.search(r"""(?:url\(|@import)\s*["']?(?:https?:)?//""", style.read_text())
