"""A reference, and a still that was taken again from there, with one change."""

import numpy as np
import pytest

from benchmarks.truth.hand_held import HeldPose, Wall
from tests.standoff.console.guide.scenes import SIZE, Stills, again_pose, levels, save, wall


@pytest.fixture(scope="session")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Stills:
    folder = tmp_path_factory.mktemp("stills")
    rng = np.random.default_rng(2)
    changed = levels(1)
    changed[340:356, 440:456] += 60
    after = Wall.of(np.clip(changed, 0, 250), SIZE, 0.8)
    return Stills(
        reference=save(wall().seen([HeldPose()], rng), folder / "reference.jpg"),
        again=save(after.seen([again_pose()], rng), folder / "again.jpg"),
        other=save(wall(9).seen([HeldPose()], rng), folder / "other.jpg"),
    )
