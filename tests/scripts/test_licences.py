"""Which licences are taken, and that every installed package has one of them."""

from email.message import Message
from importlib.metadata import Distribution, PackageMetadata, distributions
from os import PathLike
from typing import cast

import pytest
from packaging.utils import canonicalize_name

from scripts.licences import READ_BY_HAND, VENDOR, licence_of, table, verdict
from scripts.requirements_file import read_all


class Told(Distribution):
    """A package of which only the metadata are there."""

    def __init__(self, name: str, **fields: str | list[str]) -> None:
        self.message = Message()
        self.message["Name"] = name
        self.message["Version"] = "1.0"
        for key, values in fields.items():
            for value in [values] if isinstance(values, str) else values:
                self.message[key.replace("_", "-")] = value

    @property
    def metadata(self) -> PackageMetadata:
        return cast(PackageMetadata, self.message)

    def read_text(self, filename: str) -> str | None:
        return None

    def locate_file(self, path: "str | PathLike[str]") -> None:  # type: ignore[override]
        raise AssertionError(path)


@pytest.mark.parametrize(
    ("licence", "expected"),
    [
        ("MIT", "permissive"),
        ("MPL-2.0", "weak copyleft"),
        ("GPL-3.0-or-later", None),
        ("AGPL-3.0-only", None),
        ("", None),
        ("my own", None),
        ("GPL-2.0-or-later OR MPL-1.1", "weak copyleft"),
        ("GPL-2.0-or-later OR MPL-1.1 OR MIT", "permissive"),
        ("MIT AND GPL-2.0-only", None),
        ("MIT AND MPL-2.0", "weak copyleft"),
        # AND binds closer than OR.
        ("GPL-2.0-only AND MIT OR BSD-3-Clause", "permissive"),
        ("GPL-2.0-only AND (MIT OR BSD-3-Clause)", None),
        ("Apache-2.0 WITH LLVM-exception AND MIT", "permissive"),
        ("Apache-2.0 WITH Commons-Clause", None),
        ("(MIT", None),
        ("MIT)", None),
        ("MIT AND", None),
    ],
)
def test_an_expression_is_taken_if_its_choices_leave_a_way(
    licence: str, expected: str | None
) -> None:
    assert verdict(licence) == expected


def test_the_expression_counts_before_the_classifiers_and_these_before_the_words() -> None:
    classifier = "License :: OSI Approved :: MIT License"
    told = Told("lens", License_Expression="GPL-3.0-only", Classifier=classifier, License="BSD")
    assert licence_of(told) == "GPL-3.0-only"
    assert licence_of(Told("lens", Classifier=classifier, License="GPL")) == "MIT"
    assert licence_of(Told("lens", License="BSD 3-Clause License\n\nCopyright")) == "BSD-3-Clause"
    assert licence_of(Told("lens")) == ""


def test_of_several_classifiers_all_must_be_taken() -> None:
    gpl = "License :: OSI Approved :: GNU General Public License v3 (GPLv3)"
    told = Told("lens", Classifier=[gpl, "License :: OSI Approved :: MIT License"])
    assert verdict(licence_of(told)) is None


def test_only_the_libraries_of_the_vendor_come_under_its_own_terms() -> None:
    terms = "LicenseRef-NVIDIA-Proprietary"
    rows = table(
        [Told("nvidia-cublas", License_Expression=terms), Told("lens", License_Expression=terms)]
    )
    assert [(row[0], row[3]) for row in rows] == [("lens", None), ("nvidia-cublas", VENDOR)]


def test_every_locked_package_that_is_installed_has_a_licence_that_we_can_take() -> None:
    locked = {one.name for one in read_all()}
    rows = table(one for one in distributions() if canonicalize_name(one.name) in locked)
    assert len(rows) > 100
    assert [row for row in rows if row[3] is None] == []


def test_what_was_read_by_hand_is_still_in_the_lock() -> None:
    assert set(READ_BY_HAND) <= {one.name for one in read_all()}
