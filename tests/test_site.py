"""The documentation as a site: all pages are in it, links lead somewhere, nothing is fetched."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted(page.relative_to(ROOT).with_suffix("") for page in ROOT.glob("docs/**/*.md"))

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    # A broken link, a missing picture or a page without a place in the contents is a warning.
    command = ["-q", "-W", "--keep-going", "-c", "docs", "-b", "html", ".", str(folder)]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (built.returncode, built.stderr) == (0, "")
    return folder


def test_every_page_is_reached_from_the_first(site: Path) -> None:
    entrance = (site / "index.html").read_text()
    assert 'href="README.html"' in entrance
    first = (site / "README.html").read_text()
    assert len(PAGES) > 25
    for page in PAGES:
        assert f'href="{page}.html"' in first


def test_no_page_fetches_anything_from_elsewhere(site: Path) -> None:
    fetched = re.compile(r"""<(?:script|img|link|iframe)[^>]*(?:src|href)=["'](?:https?:)?//""")
    for page in site.rglob("*.html"):
        assert not fetched.search(page.read_text()), page.name
    for style in site.rglob("*.css"):
        assert not re.search(r"""(?:url\(|@import)\s*["']?(?:https?:)?//""", style.read_text())
