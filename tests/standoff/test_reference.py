"""The pages that are made from the code, and the links between all pages."""

import re
from pathlib import Path

import pytest

import standoff
from scripts.library_reference import GROUPS
from scripts.make_reference import PAGES, REFERENCE

DOCS = REFERENCE.parent
ROOT = DOCS.parent
PACKAGES = ("acquisition", "calibration", "simulation", "analysis", "hil_mocks", "standoff")
PATH = re.compile(
    r"`((?:acquisition|calibration|simulation|analysis|hil_mocks|standoff|benchmarks|tests|scripts"
    r"|configs|examples)/[\w./-]*\.\w+)`"
)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


@pytest.fixture(scope="module")
def pages() -> dict[Path, str]:
    """All pages of the documentation, those that are made from the code too."""
    written = {
        page: page.read_text("utf-8")
        for page in DOCS.rglob("*.md")
        if REFERENCE not in page.parents
    }
    return written | {REFERENCE / name: page() for name, page in PAGES.items()}


def test_the_contents_lead_to_every_page(pages: dict[Path, str]) -> None:
    linked = set(LINK.findall(pages[DOCS / "index.md"]))
    names = {page.relative_to(DOCS).as_posix() for page in pages} - {"index.md"}
    assert names <= linked


def test_no_link_leads_nowhere(pages: dict[Path, str]) -> None:
    targets = {
        (page, target)
        for page, text in pages.items()
        for target in LINK.findall(text)
        if "://" not in target
    }
    lost = [
        f"{page.relative_to(DOCS)}: {target}"
        for page, target in targets
        if (place := (page.parent / target).resolve()) not in pages and not place.exists()
    ]
    assert lost == []


def test_every_public_name_has_one_place_in_the_reference() -> None:
    names = [name for group in GROUPS for name in group.names]
    assert sorted(names) == sorted(set(dir(standoff)) - {"__version__"})


def letters(text: str) -> str:
    return re.sub(r"[^a-z]", "", text.lower())


def test_every_work_that_the_code_refers_to_is_among_the_sources() -> None:
    sources = letters((DOCS / "sources.md").read_text(encoding="utf-8"))
    cited = set[str]()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            for references in re.findall(r"\n *References\n *-+\n(.*?)\"\"\"", text, re.DOTALL):
                cited.update(re.findall(r'"([^"]+)"', references))
    works = {title for title in cited if len(title.split()) > 4}
    assert len(works) > 40
    assert {title for title in works if letters(title)[:40] not in sources} == set()


def test_paths_that_pages_name_exist(pages: dict[Path, str]) -> None:
    named = {
        path
        for page, text in pages.items()
        if REFERENCE not in page.parents
        for path in PATH.findall(text)
        if "NAME" not in path and "TASK" not in path
    }
    assert {path for path in named if not (ROOT / path).exists()} == set()
