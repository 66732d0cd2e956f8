"""The learned detector: maps of any size, whatever the light; training that learns; safe files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.photographs import luma_plane
from analysis.detectors import DetectorSpec, learned, open_detector
from analysis.detectors.learned import (
    LearnedDetector,
    TrainingOptions,
    load_learned,
    train_detector,
)
from analysis.detectors.learned._weights import on_one_grid
from analysis.errors import DetectorError
from simulation.arrays import BoolArray, Float32Array, FloatArray

torch = pytest.importorskip("torch")

SAME_GRID = np.eye(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    reference: Float32Array
    followup: Float32Array
    homography: FloatArray
    mask: BoolArray


def untrained(seed: int = 0) -> LearnedDetector:
    from analysis.detectors.learned._network import SiameseNetwork

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return LearnedDetector(SiameseNetwork())


def scene(shape: tuple[int, int], seed: int = 1) -> Float32Array:
    return (200 + 20 * np.random.default_rng(seed).standard_normal(shape)).astype(np.float32)


def spotted_pairs(count: int) -> list[Pair]:
    """Noise, and in every second follow-up a strong spot; sizes differ by a pixel."""
    rng = np.random.default_rng(4)
    pairs = []
    for number in range(count):
        side = 24 + number % 3
        y, x = np.indices((side, side))
        square = ((y - rng.integers(6, side - 6)) ** 2 + (x - rng.integers(6, side - 6)) ** 2) / 8
        spot = (number % 2) * np.exp(-square)
        levels = 100 + rng.standard_normal((2, side, side))
        pairs.append(
            Pair(
                reference=levels[0].astype(np.float32),
                followup=(levels[1] + 8 * spot).astype(np.float32),
                homography=SAME_GRID,
                mask=spot > 0.5,
            )
        )
    return pairs


def test_the_network_has_sixty_thousand_weights() -> None:
    count = sum(weight.numel() for weight in untrained().network.parameters())
    assert 50_000 < count < 150_000


@pytest.mark.parametrize("shape", [(16, 16), (17, 31), (38, 41), (64, 63), (97, 50)])
def test_a_map_has_the_follow_ups_shape_also_of_odd_sizes(shape: tuple[int, int]) -> None:
    homography = np.array([[1.3, 0.0, 2.0], [0.0, 1.3, 1.0], [0.0, 0.0, 1.0]])
    odds = untrained()(scene((140, 130)), scene(shape, 2), homography)
    assert odds.shape == shape
    assert odds.dtype == np.float32
    assert np.isfinite(odds).all()


@pytest.mark.parametrize("unit", [1e-4, 257.0])
def test_units_and_light_do_not_matter(unit: float) -> None:
    detector, before, after = untrained(), scene((40, 44)), scene((40, 44), 2)
    after = after + before
    plain = detector(before, after, SAME_GRID)
    in_units = detector(unit * before, unit * after, SAME_GRID)
    assert in_units == pytest.approx(plain, abs=2e-3)
    # Another exposure and another black level of one of the two.
    relit = detector(0.5 * before + 30, after, SAME_GRID)
    assert relit == pytest.approx(plain, abs=2e-3)


@pytest.mark.parametrize("level", [0.0, 100.0])
def test_flat_photographs_give_a_finite_map(level: float) -> None:
    flat = np.full((20, 21), level, np.float32)
    assert np.isfinite(untrained()(flat, flat, SAME_GRID)).all()


@pytest.mark.slow
def test_training_lowers_the_loss_and_finds_the_spots() -> None:
    losses: list[float] = []
    steps: list[tuple[int, int]] = []

    def told(done: int, of: int, loss: float) -> None:
        steps.append((done, of))
        losses.append(loss)

    pairs = spotted_pairs(48)
    detector = train_detector(pairs, TrainingOptions(epochs=12, seed=1), told)
    assert steps == [(number, 72) for number in range(1, 73)]
    assert np.mean(losses[-6:]) < 0.5 * np.mean(losses[:6])
    highest = [detector(p.reference, p.followup, p.homography).max() for p in pairs]
    assert np.median(highest[1::2]) > np.median(highest[::2])


@pytest.mark.slow
def test_the_same_seed_gives_the_same_weights_and_leaves_the_global_state_alone() -> None:
    before, threads = torch.random.get_rng_state(), torch.get_num_threads()

    def weights(seed: int) -> list[Any]:
        options = TrainingOptions(epochs=1, batch=4, seed=seed)
        return list(train_detector(spotted_pairs(8), options).network.parameters())

    first, again, other = weights(1), weights(1), weights(2)
    assert all(torch.equal(one, two) for one, two in zip(first, again, strict=True))
    assert not torch.equal(first[0], other[0])
    assert torch.equal(torch.random.get_rng_state(), before)
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize("parity", [0, 1])
def test_training_needs_both_kinds_of_pairs(parity: int) -> None:
    with pytest.raises(ValueError, match="with a change and pairs without"):
        train_detector(spotted_pairs(6)[parity::2])


@pytest.mark.parametrize("wrong", [{"epochs": 0}, {"batch": 0}, {"rate": 0.0}, {"seed": -1}])
def test_options_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        TrainingOptions(**wrong)


def test_a_saved_detector_answers_the_same(tmp_path: Path) -> None:
    detector, path = untrained(3), tmp_path / "detector.pt"
    detector.save(path)
    given = scene((30, 31)), scene((30, 31), 2), SAME_GRID
    assert np.array_equal(load_learned(path)(*given), detector(*given))


def damaged_files(folder: Path) -> list[Path]:
    """A file that is cut, none of torch's, one of another kind, of other weights, with code."""
    whole = folder / "whole.pt"
    untrained().save(whole)
    content = whole.read_bytes()
    weights = untrained().network.state_dict()
    for number, stored in enumerate(
        (
            [1, 2],
            {"schema": "standoff.learned-detector/9", "weights": weights},
            {"schema": "standoff.learned-detector/1", "weights": {"fine.weight": torch.ones(2)}},
            {
                "schema": "standoff.learned-detector/1",
                "weights": {name: one * np.nan for name, one in weights.items()},
            },
            {"schema": "standoff.learned-detector/1", "weights": dict(weights, more=Path("x"))},
        )
    ):
        torch.save(stored, folder / f"other-{number}.pt")
    (folder / "cut.pt").write_bytes(content[: len(content) // 2])
    (folder / "empty.pt").write_bytes(b"")
    (folder / "text.pt").write_text("weights")
    whole.unlink()
    return sorted(folder.glob("*.pt"))


def test_a_damaged_or_foreign_file_is_refused_in_one_line(tmp_path: Path) -> None:
    files = damaged_files(tmp_path)
    assert len(files) == 8
    for path in (*files, tmp_path / "none.pt", tmp_path):
        with pytest.raises(DetectorError) as caught:
            load_learned(path)
        assert caught.value.reason == "missing"
        assert path.name in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_onnx_file_says_the_same_at_any_size(tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    detector, path = untrained(), tmp_path / "detector.onnx"
    detector.export_onnx(path)
    homography = np.array([[1.3, 0.0, 2.0], [0.0, 1.3, 1.0], [0.0, 0.0, 1.0]])
    with open_detector(DetectorSpec.parse(str(path))) as opened:
        for shape in ((40, 40), (33, 57)):
            given = scene((100, 120)), scene(shape, 2), homography
            found = opened(*given).map
            assert found == pytest.approx(detector(*given), abs=1e-3)


def test_without_torch_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(learned._weights, "find_spec", lambda _: None)
    with pytest.raises(DetectorError, match=r"standoff\[learned\]"):
        load_learned(tmp_path / "a.pt")
    with pytest.raises(DetectorError, match=r"standoff\[learned\]"):
        train_detector([])


@pytest.mark.slow
def test_its_file_is_named_as_a_detector_and_runs_in_a_process_of_its_own(tmp_path: Path) -> None:
    detector, path = untrained(), tmp_path / "detector.pt"
    detector.save(path)
    spec = DetectorSpec.parse(str(path))
    assert (spec.kind, spec.name) == ("learned", "detector.pt")
    given = scene((30, 31)), scene((30, 31), 2), SAME_GRID
    with open_detector(spec) as opened:
        assert opened(*given).map == pytest.approx(detector(*given), abs=1e-5)
    path.write_bytes(path.read_bytes()[:999])
    assert DetectorSpec.parse(str(path)).identity != spec.identity
    with pytest.raises(DetectorError, match="is damaged"), open_detector(spec):
        pass


def test_colours_are_looked_at_by_their_luma() -> None:
    rng = np.random.default_rng(3)
    colours = rng.normal(100, 10, (2, 20, 24, 3)).astype(np.float32)
    greys = [luma_plane(one).astype(np.float32) for one in colours]
    pose = np.array([[1.0, 0, 1.5], [0, 1, 0.5], [0, 0, 1]])
    found = on_one_grid(colours[0], colours[1], pose)
    np.testing.assert_allclose(found, on_one_grid(greys[0], greys[1], pose), rtol=1e-5)
