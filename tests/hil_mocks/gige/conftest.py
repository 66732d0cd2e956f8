from collections.abc import Iterator

import pytest

from hil_mocks.practice_bench import PracticeBench
from tests.hil_mocks.gige_bench import gige_bench
from tests.hil_mocks.gige_client import RawClient


@pytest.fixture
def bench() -> Iterator[PracticeBench]:
    with gige_bench() as bench:
        yield bench


@pytest.fixture
def client(bench: PracticeBench) -> Iterator[RawClient]:
    with RawClient(bench.camera.address) as client:
        yield client
