"""A bounded run of every target; ``python -m tests.fuzz --minutes N`` searches longer."""

import pytest

from tests.fuzz.photograph_targets import PHOTOGRAPH_TARGETS
from tests.fuzz.result_targets import RESULT_TARGETS
from tests.fuzz.session_targets import SESSION_TARGETS
from tests.fuzz.target import FuzzTarget
from tests.fuzz.wire_targets import WIRE_TARGETS

TARGETS = (*SESSION_TARGETS, *RESULT_TARGETS, *PHOTOGRAPH_TARGETS, *WIRE_TARGETS)


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_only_the_documented_error_comes_out(target: FuzzTarget) -> None:
    target.search()
