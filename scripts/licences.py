"""List the licence of every installed package; exit status 1 if there is one that we cannot take.

    make licences

standoff is under the MIT licence and passes no package on: people install them from where they are
published. So what permits use and linking is taken, weak copyleft included; strong copyleft, terms
against commercial use and packages that tell no licence are refused.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, distributions

from packaging.utils import canonicalize_name

from scripts.requirements_file import read

# Use, change and passing on are permitted. LicenseRef-BSD is one of the BSD licences, LicenseRef-
# Public-Domain has no terms: the metadata say no more.
PERMISSIVE = {
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "LicenseRef-BSD",
    "LicenseRef-Public-Domain",
    "MIT",
    "MIT-0",
    "MIT-CMU",
    "PSF-2.0",
    "Zlib",
    "bzip2-1.0.6",
}

# Taken as they are, unmodified: changes to them would have to be published, use need not.
WEAK_COPYLEFT = {
    "LGPL-2.0-or-later",
    "LGPL-2.1-only",
    "LGPL-2.1-or-later",
    "MPL-1.1",
    "MPL-2.0",
}

# What metadata from before SPDX expressions say, in classifiers and in the field of a line.
WORDED = {
    "3-clause bsd license": "BSD-3-Clause",
    "apache 2.0": "Apache-2.0",
    "apache software license": "Apache-2.0",
    "bsd": "LicenseRef-BSD",  # does not say with how many clauses
    "bsd 2-clause license": "BSD-2-Clause",
    "bsd 3-clause license": "BSD-3-Clause",
    "bsd license": "LicenseRef-BSD",
    "gnu lesser general public license v2 or later (lgplv2+)": "LGPL-2.0-or-later",
    "isc license (iscl)": "ISC",
    "mit license": "MIT",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "python software foundation license": "PSF-2.0",
}

# Read in the packages themselves, where their metadata say nothing or everything at once.
READ_BY_HAND = {
    # LICENSE, and that of axe-core, which its wheel holds.
    "axe-playwright-python": "MIT AND MPL-2.0",
    # The GPL is that of an Emacs mode, which the wheel does not hold.
    "docutils": "BSD-2-Clause AND LicenseRef-Public-Domain",
    # Its own and those of the filters that its wheel holds, doc/information.rst of its source.
    "hdf5plugin": "MIT AND BSD-2-Clause AND BSD-3-Clause AND Apache-2.0 AND bzip2-1.0.6 AND Zlib",
    "historydict": "BSD-3-Clause",  # LICENSE
    "openexr": "BSD-3-Clause",  # LICENSE.md
    "pyphen": "GPL-2.0-or-later OR LGPL-2.1-or-later OR MPL-1.1",  # the choice is ours
}

VENDOR = "the vendor's own terms"


def licence_of(package: Distribution) -> str:
    """The SPDX expression of a package, or its own words; empty if it tells none."""
    name = canonicalize_name(package.metadata["Name"])
    if name in READ_BY_HAND:
        return READ_BY_HAND[name]
    # get_all: a missing field is a KeyError where the backport of importlib.metadata is imported.
    (expression, *_) = package.metadata.get_all("License-Expression") or [""]
    if expression:
        return str(expression)
    classifiers = [
        text.rpartition("::")[2].strip()
        for text in package.metadata.get_all("Classifier") or []
        if text.startswith("License ::")
    ]
    named = [text for text in classifiers if text not in ("OSI Approved", "DFSG approved")]
    if not named:
        (text, *_) = package.metadata.get_all("License") or [""]
        named = text.strip().splitlines()[:1]
    return " AND ".join(WORDED.get(text.strip().lower(), text.strip()) for text in named)


def verdict(licence: str) -> str | None:
    """Whether it is "permissive" or "weak copyleft"; None if it is not one that we can take.

    An SPDX expression is read as SPDX 2.3, annex D, orders it: WITH, then AND, then OR.
    """
    tokens = re.findall(r"\(|\)|[^()\s]+", licence)
    kinds = [None, "weak copyleft", "permissive"]  # by how little they ask

    def choice() -> int:
        rank = every()
        while tokens and tokens[0] == "OR":
            tokens.pop(0)
            rank = max(rank, every())
        return rank

    def every() -> int:
        rank = one()
        while tokens and tokens[0] == "AND":
            tokens.pop(0)
            rank = min(rank, one())
        return rank

    def one() -> int:
        if not tokens:
            return 0
        name = tokens.pop(0)
        if name == "(":
            rank = choice()
            return rank if tokens and tokens.pop(0) == ")" else 0
        if tokens[:1] == ["WITH"]:
            name = " ".join([name, *tokens[:2]])
            del tokens[:2]
        return 2 if name in PERMISSIVE else 1 if name in WEAK_COPYLEFT else 0

    rank = choice()
    return None if tokens else kinds[rank]


def table(packages: Iterable[Distribution]) -> list[tuple[str, str, str, str | None]]:
    """Name, version, licence and verdict of each package, by name.

    NVIDIA's libraries have terms of their own. They are installed only with a build of torch that
    needs them, from NVIDIA's own publication, and we pass them on to nobody.
    """
    vendors = {one.name for one in read("cuda")}
    rows = []
    for package in packages:
        name = canonicalize_name(package.metadata["Name"])
        licence = licence_of(package)
        found = verdict(licence) or (VENDOR if name in vendors else None)
        rows.append((str(name), package.version, licence, found))
    return sorted(rows)


def main() -> int:
    """Print the table; the exit status."""
    rows = table(distributions())
    width = max(len(name) + len(version) for name, version, _, _ in rows) + 2
    refused = []
    for name, version, licence, found in rows:
        line = f"{name} {version}".ljust(width) + (licence or "tells no licence")
        print(line if found == "permissive" else f"{line}  ({found or 'refused'})")
        if found is None:
            refused.append(name)
    if refused:
        print(
            f"licences that we cannot take: {', '.join(refused)}: read them, then add what they "
            "are to READ_BY_HAND in scripts/licences.py, or do without the package",
            file=sys.stderr,
        )
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
