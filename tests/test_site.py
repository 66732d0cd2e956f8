"""The documentation as a site: pages, links, formulas, nothing fetched, nothing too wide."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests.standoff.console.console_rig import chromium_browser

ROOT = Path(__file__).parent.parent
PAGES = sorted(page.relative_to(ROOT).with_suffix("") for page in ROOT.glob("docs/**/*.md"))
PHONE_PX = 390
# Elements that reach beyond the screen and are not in a box of their own that scrolls.
TOO_WIDE = """() => {
    const scrolls = (element) => {
        for (let box = element.parentElement; box && box !== document.body; box = box.parentElement)
            if (['auto', 'scroll'].includes(getComputedStyle(box).overflowX)) return true;
        return false;
    };
    return [...document.querySelectorAll('article *')]
        .filter((one) => one.getBoundingClientRect().right > innerWidth + 1 && !scrolls(one))
        .map((one) => one.outerHTML.slice(0, 100));
}"""
BROKEN_IMAGES = "[...document.images].filter((one) => !one.naturalWidth).map((one) => one.src)"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site; a broken link, a page without a place or a wrong formula is a warning."""
    folder = tmp_path_factory.mktemp("site")
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


@pytest.fixture(scope="module")
def phone() -> Iterator[Page]:
    with chromium_browser() as browser:
        yield browser.new_page(viewport={"width": PHONE_PX, "height": 844})


def test_the_site_holds_every_page_and_names_nothing_elsewhere_to_fetch(site: Path) -> None:
    assert 'href="README.html"' in (site / "index.html").read_text()
    first = (site / "README.html").read_text()
    assert len(PAGES) > 60
    for page in PAGES:
        assert f'href="{page}.html"' in first
    fetched = re.compile(r"""<(?:script|img|link|iframe)[^>]*(?:src|href)=["'](?:https?:)?//""")
    for path in site.rglob("*.html"):
        assert not fetched.search(path.read_text()), path.name
    for style in site.rglob("*.css"):
        assert not re.search(r"""(?:url\(|@import)\s*["']?(?:https?:)?//""", style.read_text())


def test_formulas_are_mathml_and_none_is_left_as_latex(site: Path) -> None:
    for page in sorted(ROOT.glob("docs/theory-*.md")):
        made = (site / "docs" / f"{page.stem}.html").read_text()
        text = page.read_text()
        shown = text.count("\n$$\n") // 2
        assert made.count('display="block"') == shown, page.stem
        assert made.count('display="inline"') > 5, page.stem
        article = re.sub(r"<pre>.*?</pre>|<code.*?</code>", "", made, flags=re.DOTALL)
        assert not re.search(r"\\(?:frac|sum|int|begin|text|sigma|Sigma)|\$", article), page.stem


def test_no_page_is_wider_than_a_phone_and_none_asks_the_network(site: Path, phone: Page) -> None:
    asked: list[str] = []
    phone.on("request", lambda request: asked.append(request.url))
    for path in sorted(site.rglob("*.html")):
        if path == site / "index.html":  # leads on to the first page
            continue
        phone.goto(path.as_uri())
        page = str(path.relative_to(site))
        assert phone.evaluate("document.scrollingElement.scrollWidth") <= PHONE_PX, page
        assert phone.evaluate(TOO_WIDE) == [], page
        assert phone.evaluate(BROKEN_IMAGES) == [], page
    assert asked
    assert {url.split(":")[0] for url in asked} <= {"file", "data"}
