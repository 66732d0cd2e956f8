"""What a command or the library says, in words of a page: a browser has no command line.

Errors are written as "what is wrong; what to do". A remedy that a page has itself is said in the
page's words; another that names an option or a command is said to be one of a terminal.
"""

import re

_OF_THE_PAGE = (
    (
        re.compile(r"^--force replaces .*$"),
        "to replace it, tick “replace” or press “Compute again”",
    ),
    (re.compile(r"\b(?:run|give|type) the same command again\b.*$"), "start it again"),
    (re.compile(r"^the same command goes on"), "started again, it goes on"),
    (re.compile(r"\band run (?:it )?again$"), "and start it again"),
)
_USAGE = re.compile(r"^Invalid value(?: for '?--[a-z-]+'?)?: ")
_OF_A_TERMINAL = re.compile(
    r"(?<![\w-])--[a-z][a-z-]+|`standoff |\bstandoff [a-z-]+ [A-Za-z-]|\bpip install\b"
)

_IN_A_TERMINAL = "in a terminal: "


def page_words(text: str) -> str:
    """Return a sentence of a command with the remedies that a page has.

    What was found wrong stands before the first semicolon, and stays as it is.
    """
    fault, *remedies = _USAGE.sub("", text).split("; ")
    return "; ".join([fault, *(_remedy(each) for each in remedies)])


def _remedy(clause: str) -> str:
    for pattern, words in _OF_THE_PAGE:
        if pattern.search(clause):
            return pattern.sub(words, clause)
    is_told = clause.startswith(_IN_A_TERMINAL) or "console" in clause
    return clause if is_told or not _OF_A_TERMINAL.search(clause) else _IN_A_TERMINAL + clause
