"""The documentation as a site: ``make docs`` builds build/site with Sphinx, without a network.

The pages are written for a reader of the repository; what the site needs beside them, its tables of
contents, is read from docs/index.md. The reference is made from the code first.
"""

import re
import subprocess
import sys
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent / "site"))

project = "standoff"
extensions = ["myst_parser", "mathml"]
include_patterns = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "docs/**.md"]
exclude_patterns = [".*", "build", "*-output"]
root_doc = "README"
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
myst_dmath_allow_space = False
myst_dmath_allow_digits = False
html_math_renderer = "mathml"
smartquotes = False
highlight_language = "none"
html_theme = "furo"
html_title = project
html_static_path = ["site/static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False

_CONTENTS = "docs/index"
_SECTION = re.compile(r"^## (?P<title>.+)\n(?P<text>(?:(?!^## ).*\n?)*)", re.MULTILINE)
_PAGE = re.compile(r"\[(?P<title>[^]]+)\]\((?!\.\./)(?P<path>[^)#]+)\.md\)")
_TOCTREE = """
```{{toctree}}
:hidden:
:caption: {caption}

{pages}
```
"""
_ENTRANCE = """<!doctype html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url=README.html">
<title>standoff</title>
<a href="README.html">standoff</a>
"""


def _make_reference(app: Sphinx) -> None:
    subprocess.run([sys.executable, "-m", "scripts.make_reference"], cwd=app.srcdir, check=True)


def _add_contents(app: Sphinx, docname: str, source: list[str]) -> None:
    """Give the first page the sections of docs/index.md as tables of contents."""
    if docname != root_doc:
        return
    app.env.note_dependency(f"{_CONTENTS}.md", docname=docname)
    index = (Path(app.srcdir) / f"{_CONTENTS}.md").read_text(encoding="utf-8")
    trees = [("Start", [_CONTENTS])]
    for section in _SECTION.finditer(index):
        pages = [
            f"{page['title']} <docs/{page['path']}>" for page in _PAGE.finditer(section["text"])
        ]
        trees.append((section["title"], pages))
    trees.append(("Project", ["CHANGELOG", "CONTRIBUTING", "SECURITY"]))
    source[0] += "".join(
        _TOCTREE.format(caption=caption, pages="\n".join(pages)) for caption, pages in trees
    )


def _add_entrance(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        (Path(app.outdir) / "index.html").write_text(_ENTRANCE, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", _make_reference)
    app.connect("source-read", _add_contents)
    app.connect("build-finished", _add_entrance)
    return {"parallel_read_safe": True}
