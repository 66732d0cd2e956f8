"""Guesses of the token, and who is slowed down by whose."""

import pytest

from standoff.console.serving import login_throttle
from standoff.console.serving.login_throttle import LoginThrottle
from tests.standoff.console.serving.test_allowance import Clock


def guesses_in(throttle: LoginThrottle, clock: Clock, seconds: float, *peers: str) -> int:
    """Guess as often as possible, a hundred times a second."""
    made = 0
    for _ in range(round(100 * seconds)):
        for peer in peers:
            if throttle.wait_s(peer) == 0:
                throttle.note_wrong(peer)
                made += 1
        clock.now_s += 0.01
    return made


def test_after_five_guesses_one_a_second() -> None:
    clock = Clock()
    throttle = LoginThrottle(clock)
    assert guesses_in(throttle, clock, 0.5, "192.0.2.7") == 5
    assert throttle.wait_s("192.0.2.7") == pytest.approx(0.5)
    assert guesses_in(throttle, clock, 100.0, "192.0.2.7") == pytest.approx(100, abs=1)


def test_nobody_is_slowed_down_by_another_address() -> None:
    clock = Clock()
    throttle = LoginThrottle(clock)
    guesses_in(throttle, clock, 3.5, "192.0.2.7")
    assert throttle.wait_s("192.0.2.7") > 0
    assert throttle.wait_s("192.0.2.8") == 0


def test_the_addresses_of_one_computer_count_as_one() -> None:
    clock = Clock()
    throttle = LoginThrottle(clock)
    own = [f"2001:db8::{number:x}" for number in range(20)]
    assert guesses_in(throttle, clock, 0.5, *own) == 5
    assert throttle.wait_s("2001:db8:0:1::1") == 0
    guesses_in(throttle, clock, 0.5, "::ffff:192.0.2.7")
    assert throttle.wait_s("192.0.2.7") > 0  # the same address, written for IPv6


def test_very_many_addresses_share_one_allowance_and_no_more_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(login_throttle, "MAX_PEERS", 3)
    clock = Clock()
    throttle = LoginThrottle(clock)
    peers = [f"192.0.2.{number}" for number in range(200)]
    assert guesses_in(throttle, clock, 0.5, *peers) == (3 + 1) * 5
    assert throttle.wait_s("198.51.100.1") > 0  # a new one, too
    clock.now_s += 10.0  # forgotten, as each of them may guess five times again
    guesses_in(throttle, clock, 0.5, "198.51.100.1")
    assert throttle.wait_s("198.51.100.1") > 0
    assert throttle.wait_s("198.51.100.2") == 0
