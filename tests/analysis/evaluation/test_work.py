"""Scores are kept and resumed, in the same bits; a detector that fails is named with its pair."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from analysis.errors import SweepError
from analysis.evaluation import Evaluation
from analysis.sweep import SweepOptions
from simulation import GaussianPsf
from simulation.arrays import Float32Array, FloatArray
from standoff.errors import ApplicationError

PSF = GaussianPsf(sigma_px=0.7)
Scored = Callable[[Float32Array, Float32Array, FloatArray], object]


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(5)
    for number in range(3):
        image = 200 + 20 * rng.standard_normal((140, 150))
        tifffile.imwrite(folder / f"scene-{number}.tif", image.astype(np.float32))
    return folder


def task(crops: int = 3) -> standoff.EvaluationTask:
    return standoff.EvaluationTask(
        zooms=(1.0, 1.5), contrasts_dn=(30.0,), crop_px=48, crops=crops, model="matched"
    )


def brightest(
    reference: Float32Array, followup: Float32Array, homography: FloatArray
) -> Float32Array:
    """A map."""
    return followup


CALLS: list[int] = []
INTERRUPTED_AT: list[int] = []


def counted(
    reference: Float32Array, followup: Float32Array, homography: FloatArray
) -> Float32Array:
    """Count the calls, and be interrupted at one of them."""
    CALLS.append(1)
    if len(CALLS) in INTERRUPTED_AT:
        raise KeyboardInterrupt
    return followup


@pytest.fixture(autouse=True)
def _uncounted() -> None:
    CALLS.clear()
    INTERRUPTED_AT.clear()


def evaluated(
    detector: Scored, photographs: Path, state: Path | None = None, *, strict: bool = False
) -> Evaluation:
    found = standoff.evaluate(
        detector,  # type: ignore[arg-type]
        photographs,
        PSF,
        task(),
        state=state,
        sweep=SweepOptions(strict=strict),
    ).evaluation
    assert found is not None
    return found


def without_provenance(found: Evaluation) -> dict[str, object]:
    return found.model_dump(exclude={"provenance", "detector"})


@pytest.mark.slow
def test_an_interrupted_evaluation_goes_on_where_it_was(photographs: Path, tmp_path: Path) -> None:
    INTERRUPTED_AT.append(20)
    with pytest.raises(KeyboardInterrupt):
        evaluated(counted, photographs, tmp_path)
    resumed = evaluated(counted, photographs, tmp_path)
    # 3 photographs, 3 crops, 2 zooms, with and without a change; the one broken off comes again.
    assert len(CALLS) == 36 + 2
    whole = evaluated(counted, photographs)
    assert resumed.curves == whole.curves


@pytest.mark.slow
def test_a_second_run_asks_the_detector_nothing(photographs: Path, tmp_path: Path) -> None:
    found = evaluated(counted, photographs, tmp_path)
    assert len(CALLS) == 36
    assert evaluated(counted, photographs, tmp_path).curves == found.curves
    assert len(CALLS) == 36
    assert len(list(tmp_path.glob("*.records"))) == 1


@pytest.mark.slow
def test_only_pairs_of_new_photographs_are_scored(photographs: Path, tmp_path: Path) -> None:
    files = sorted(photographs.iterdir())
    for some in (files[:2], files):
        standoff.evaluate(counted, some, PSF, task(), state=tmp_path)
    assert len(CALLS) == 36
    assert (
        evaluated(counted, photographs, tmp_path).curves == evaluated(counted, photographs).curves
    )


@pytest.mark.slow
def test_two_workers_give_the_same_bits(photographs: Path) -> None:
    alone = evaluated(brightest, photographs)
    shared = standoff.evaluate(brightest, photographs, PSF, task(), sweep=SweepOptions(workers=2))
    assert shared.evaluation is not None
    assert without_provenance(shared.evaluation) == without_provenance(alone)


def failing(
    kind: str, reference: Float32Array, followup: Float32Array, homography: FloatArray
) -> object:
    """Fail for every follow-up that is smaller than the reference."""
    if followup.shape == reference.shape:
        return float(followup.max())
    if kind == "crashed":
        raise RuntimeError("no such network")
    return {"not_finite": float("nan"), "shape": np.zeros((3, 3), np.float32)}[kind]


@pytest.mark.parametrize("reason", ["crashed", "not_finite", "shape"])
def test_a_failing_detector_is_named_with_its_pair(photographs: Path, reason: str) -> None:
    with pytest.raises(SweepError, match=r"scene-\d\.tif: pair 1 without a change, zoom 1\.5"):
        evaluated(partial(failing, reason), photographs, strict=True)


def sometimes(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> float:
    """Fail for a quarter of the pairs."""
    if float(followup[0, 0]) % 1 < 0.25:
        raise ValueError("not that one")
    return float(followup.max())


def test_pairs_without_a_score_are_left_out_and_listed(photographs: Path) -> None:
    found = evaluated(sometimes, photographs)
    assert 0 < found.failed_pairs < 36
    assert len(found.failed) == found.failed_pairs
    assert {one.reason for one in found.failed} == {"crashed"}
    assert found.failed_sentence is not None
    assert "not that one" in found.failed_sentence
    assert sum(sum(curve.pairs) for curve in found.curves) < 18


def once(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> float:
    """Fail at the 20th call; it is another one that is answered."""
    CALLS.append(1)
    if len(CALLS) == 20:
        raise OSError("the licence server does not answer")
    return float(followup.max())


@pytest.mark.slow
def test_a_pair_that_failed_is_tried_again_by_the_next_run(
    photographs: Path, tmp_path: Path
) -> None:
    assert evaluated(once, photographs, tmp_path).failed_pairs == 1
    again = evaluated(once, photographs, tmp_path)
    assert again.failed == []
    assert len(CALLS) == 36 + 2  # the crop's pair without and with a change
    assert again.curves == evaluated(once, photographs).curves


def test_a_detector_that_never_answers_ends_the_work(photographs: Path) -> None:
    def never(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> float:
        raise ValueError("out of order")

    with pytest.raises(SweepError, match=r"gave nothing for \d+ pairs.*out of order"):
        standoff.evaluate(never, photographs, PSF, task(crops=10))


def test_photographs_that_are_too_small_are_all_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "small.tif", np.ones((40, 40), np.float32))
    with pytest.raises(ApplicationError, match=r"small\.tif.*need \d+ px a side"):
        evaluated(brightest, tmp_path)
