"""Formulas of the pages as MathML, written while the site is built: no script and no network."""

import re

from docutils import nodes
from latex2mathml import exceptions
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

_LOGGER = logging.getLogger(__name__)
# The converter's errors have no base of their own.
_ERRORS = tuple(kind for kind in vars(exceptions).values() if isinstance(kind, type))
# The converter's name of the environment, and bars that know which side they are on.
_WRITTEN_OTHERWISE = {
    r"\begin{aligned}": r"\begin{split}",
    r"\end{aligned}": r"\end{split}",
    r"\lvert": "{|",
    r"\rvert": "|}",
}
_UNKNOWN = re.compile(r">\\\w+<")
# What the converter leaves to the browser, which has no way to know: a function's name stands off
# what follows unless that is a parenthesis, a minus after a parenthesis or a sign is a sign, a
# fraction in one line is close, and a prime has its own height.
_SPACING = (
    (
        re.compile(r"<m([io])>([a-zA-Z]{2,})</m\1>(?=(?:<mrow>)?<mo[^>]*>&#x00028;)"),
        r'<mo form="prefix" lspace="0.1667em" rspace="0">\2</mo>',
    ),
    (
        re.compile(r"<m([io])>([a-zA-Z]{2,})</m\1>"),
        r'<mo form="prefix" lspace="0.1667em" rspace="0.1667em">\2</mo>',
    ),
    (
        re.compile(
            r"(<mo[^>]*>(?:&#x00028;|&#x0003D;|&#x0002C;|&#x0005B;)</mo>)<mo>&#x02212;</mo>"
        ),
        r'\1<mo form="prefix">&#x02212;</mo>',
    ),
    (re.compile("<mo>&#x0002F;</mo>"), '<mo lspace="0.06em" rspace="0.06em">&#x0002F;</mo>'),
    (
        re.compile("<msup>(<mi>[^<]*</mi>)<mi>&#x0203([23]);</mi></msup>"),
        r'<mrow>\1<mo lspace="0" rspace="0">&#x0203\2;</mo></mrow>',
    ),
)


def mathml(latex: str, display: str) -> str:
    """The MathML of a formula; ``display`` is "inline" or "block".

    Raises
    ------
    ValueError
        If a command is unknown or the formula is not complete.
    """
    text = latex
    for written, other in _WRITTEN_OTHERWISE.items():
        text = text.replace(written, other)
    try:
        made = convert(text, display=display)
    except _ERRORS as error:
        raise ValueError(f"no formula: {latex!r} ({type(error).__name__})") from error
    unknown = _UNKNOWN.search(made)
    if unknown:
        raise ValueError(f"no formula: {latex!r} ({unknown.group().strip('<>')} is unknown)")
    for pattern, spaced in _SPACING:
        made = pattern.sub(spaced, made)
    return made


def _visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    _write(translator, node, "inline")
    raise nodes.SkipNode


def _visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append('<div class="formula">')
    _write(translator, node, "block")
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def _write(translator: HTML5Translator, node: nodes.Element, display: str) -> None:
    try:
        translator.body.append(mathml(node.astext(), display))
    except ValueError as error:
        _LOGGER.warning("%s", error, location=node)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
