"""The practice bench in real time: what its camera sees of a stage that moves while it renders."""

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np
import pytest

from hil_mocks.gige import FrameRequest
from hil_mocks.practice_bench import PracticeBench
from tests.hil_mocks.benches import bench_config

REQUEST = FrameRequest(acquisition=1, index=0, exposure_us=4000.0, gain_db=0.0, black_level_dn=64.0)


def moved_in_every_rendering(
    bench: PracticeBench, monkeypatch: pytest.MonkeyPatch, move: Callable[[], None]
) -> Iterator[int]:
    """Move the stage at the end of each rendering; the next of the iterator is their number."""
    renderings, render = count(), bench.truth.irradiance

    def rendered(*scene: object) -> object:
        view = render(*scene)  # type: ignore[arg-type]  # passed on as they came
        next(renderings)
        move()
        return view

    monkeypatch.setattr(bench.truth, "irradiance", rendered)
    return renderings


@pytest.mark.slow
def test_a_stage_that_came_to_rest_during_a_rendering_is_seen_where_it_rests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    height_mm = [200.0]
    bench = PracticeBench(bench_config(), height_mm=lambda: height_mm[0])
    bench.place("coins")
    renderings = moved_in_every_rendering(
        bench, monkeypatch, lambda: height_mm.__setitem__(0, 220.0)
    )
    level_dn = bench.source.levels_dn(REQUEST).astype(np.float64)
    assert next(renderings) == 2
    on_the_way, at_rest = (
        bench.truth.expected_image_dn("coins", 0.0, at_mm, exposure_us=REQUEST.exposure_us)
        for at_mm in (200.0, 220.0)
    )
    assert abs(level_dn - at_rest).mean() < abs(level_dn - on_the_way).mean() / 2


def test_a_stage_that_still_moves_does_not_hold_the_picture_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heights_mm = count(200.0, 0.1)
    bench = PracticeBench(bench_config(), height_mm=lambda: next(heights_mm))
    renderings = moved_in_every_rendering(bench, monkeypatch, lambda: None)
    bench.source.levels_dn(REQUEST)
    assert next(renderings) == 1
