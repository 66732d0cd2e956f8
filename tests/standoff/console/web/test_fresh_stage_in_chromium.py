"""A stage with Grbl as it is after it was switched on: locked, until it is homed from the page."""

from pathlib import Path

import pytest

from tests.standoff.console.console_rig import (
    FEW_PICTURES,
    console_rig,
    take_control,
    text,
    wait_until,
)

pytestmark = [pytest.mark.slow, pytest.mark.waits]


def test_a_fresh_grbl_in_alarm_says_to_home_it_beside_the_button(tmp_path: Path) -> None:
    with console_rig(tmp_path, *FEW_PICTURES) as rig, rig.page() as page:
        take_control(page)
        wait_until(lambda: text(page, "#stage-motion") == "ALARM", "it is locked")
        assert text(page, "#stage-target").startswith("locked until it is homed: press Home")
        assert text(page, "#stage-homed") == "not homed"
        page.wait_for_selector("#stage #home.primary:enabled")  # the one that stands out
        assert page.locator("#stage .primary").count() == 1
        assert not page.is_enabled("[data-step='10']")
        page.click("#home")
        wait_until(lambda: text(page, "#stage-homed") == "homed", "homed")
        wait_until(lambda: text(page, "#stage-motion") == "at rest", "no alarm")
        assert text(page, "#stage-target") == ""
        assert page.locator("#stage .primary").count() == 0
        assert not page.is_visible("#unlock")
        assert rig.faults == []
