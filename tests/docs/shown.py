"""Whether what a page shows after a command is what the command printed.

Lines are compared in order, without regard to blanks and to how wide a table is drawn. ``...`` in a
line stands for anything, ``...`` alone for any lines. Numbers agree within 5 %, or two of the
last digit that the page shows; whole numbers below 20 agree exactly. Remarks about compiling and
lines of progress depend on the machine and are left out.
"""

import re

RELATIVE = 0.05
EXACT_BELOW = 20

_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")
_OF_THE_MACHINE = re.compile(r"note: compiling |.*: \d+ of \d+ after |Matplotlib is building")


def first_difference(shown: str, printed: str) -> str | None:
    """The first line of ``shown`` that was not printed where it should be, or None."""
    lines = [_plain(line) for line in printed.splitlines() if not _OF_THE_MACHINE.match(line)]
    lines = [line for line in lines if line]
    place, may_skip = 0, False
    for line in shown.splitlines():
        expected = _plain(line)
        if not expected:
            continue
        if expected == "...":
            may_skip = True
            continue
        ahead = range(place, len(lines)) if may_skip else range(place, min(place + 1, len(lines)))
        found = next((at for at in ahead if agrees(expected, lines[at])), None)
        if found is None:
            return line
        place, may_skip = found + 1, False
    return None if place == len(lines) or may_skip else f"nothing, where there is: {lines[place]}"


def agrees(shown: str, printed: str) -> bool:
    """Whether one line that a page shows is the line that was printed."""
    found = re.fullmatch(_pattern(shown), printed)
    numbers = _NUMBER.findall(shown)
    return found is not None and all(
        _near(mine, its) for mine, its in zip(numbers, found.groups(), strict=True)
    )


def _pattern(line: str) -> str:
    """Of lines with the words of ``line`` and any numbers, a group each."""
    pattern, place = "", 0
    for match in _NUMBER.finditer(line):
        pattern += _words(line[place : match.start()]) + r"([-+]?[\d.,]+(?:e[-+]?\d+)?)"
        place = match.end()
    return pattern + _words(line[place:])


def _plain(line: str) -> str:
    """``line`` without what the width of a table changes."""
    line = re.sub(r"[━─╇╈┳┻┏┓┡┩└┘┴┼╋]+", "", line)
    return re.sub(r"\s+", " ", re.sub(r"\s*([│┃])\s*", r" \1 ", line)).strip()


def _words(text: str) -> str:
    return ".*".join(re.escape(part) for part in text.split("..."))


def _near(shown: str, printed: str) -> bool:
    try:
        mine, its = float(shown.replace(",", "")), float(printed.replace(",", ""))
    except ValueError:
        return False
    mantissa, _, exponent = shown.partition("e")
    decimals = len(mantissa.partition(".")[2])
    if not decimals and not exponent and abs(mine) < EXACT_BELOW:
        return mine == its
    last_digit = 10.0 ** (int(exponent or 0) - decimals)
    return abs(mine - its) <= max(2 * last_digit, RELATIVE * abs(mine)) * (1 + 1e-9)


def with_its_numbers(shown: str, printed: str) -> str:
    """``shown`` with the numbers that were printed, in lines that agree in words alone.

    Of several such lines it is the one with the most numbers as they were. A number that ``...``
    follows stays.
    """
    lines = [_plain(line) for line in printed.splitlines()]
    renewed, place = [], 0
    for line in shown.splitlines(keepends=True):
        mine = _NUMBER.findall(_plain(line))
        alike = [
            (at, found.groups())
            for at in range(place, len(lines))
            if mine and (found := re.fullmatch(_pattern(_plain(line)), lines[at]))
        ]
        agreeing = [at for at, _ in alike if agrees(_plain(line), lines[at])]
        if agreeing or not alike:
            renewed.append(line)
            place = agreeing[0] + 1 if agreeing else place
            continue
        at, its = max(alike, key=lambda one: sum(map(str.__eq__, mine, one[1])))
        renewed.append(_renumbered(line, its))
        place = at + 1
    return "".join(renewed)


def _renumbered(line: str, numbers: tuple[str, ...]) -> str:
    its = iter(numbers)
    return _NUMBER.sub(lambda old: (old[0], next(its))[not line.startswith("...", old.end())], line)
