"""One Chromium for all tests of this folder."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="package")
def browser() -> Iterator["Browser"]:
    from tests.standoff.console.console_rig import chromium_browser  # skips without Playwright

    with chromium_browser() as opened:
        yield opened
