"""A running console over the simulated bench, small and fast."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from standoff.console.bench_hub import BenchHub
from tests.standoff.console.hub_fixtures import running_hub


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[BenchHub]:
    with running_hub(tmp_path) as made:
        yield made
