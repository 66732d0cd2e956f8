"""The reference in docs is what the code says today."""

import re
from pathlib import Path

import pytest

import standoff
from scripts.library_reference import GROUPS
from scripts.make_reference import PAGES, REFERENCE

DOCS = REFERENCE.parent
ROOT = DOCS.parent
PACKAGES = ("acquisition", "calibration", "simulation", "analysis", "hil_mocks", "standoff")
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


@pytest.mark.parametrize("name", PAGES)
def test_the_reference_is_up_to_date(name: str) -> None:
    made = PAGES[name]()
    assert (REFERENCE / name).read_text(encoding="utf-8") == made, (
        "run python -m scripts.make_reference"
    )


def test_the_contents_lead_to_every_page() -> None:
    linked = set(LINK.findall((DOCS / "index.md").read_text(encoding="utf-8")))
    pages = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")} - {"index.md"}
    assert pages <= linked


@pytest.mark.parametrize(
    "page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.relative_to(DOCS).as_posix()
)
def test_no_link_leads_nowhere(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


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
