import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from simulation.choices import KernelModel
from simulation.kernelgan._estimate import EstimatedKernel, KernelGanSettings
from tests.standoff.conftest import Command

TEXTURE = np.random.default_rng(0).integers(0, 4000, (90, 120)).astype(np.uint16)
MODEL: KernelModel = "gaussian-kernelgan"


@pytest.fixture
def image_file(tmp_path: Path) -> Path:
    path = tmp_path / "texture.tif"
    tifffile.imwrite(path, TEXTURE)
    return path


def _arguments(image: Path, tmp_path: Path, *more: object) -> tuple[object, ...]:
    return (
        "simulate", image, "--zoom", 2, "--model", MODEL, "--out", tmp_path / "far.tif",
        "--kernel-cache", tmp_path / "kernels", "--force", *more,
    )  # fmt: skip


def test_a_kernel_is_trained_once_and_the_follow_up_is_on_the_common_grid(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    done = command.done(*_arguments(image_file, tmp_path, "--steps", 3, "--json"))
    document = json.loads(done.out)
    assert document["size"] == [60, 45]
    assert not document["kernel_from_cache"]
    assert Path(document["kernel"]).is_file()
    first = tifffile.imread(tmp_path / "far.tif")
    again = command(*_arguments(image_file, tmp_path, "--steps", 3, "--json"))
    assert json.loads(again.out)["kernel_from_cache"]
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "far.tif"), first)
    # Nearest sampling is 0.5 px off at zoom 2: another image of the same mean.
    command.done(*_arguments(image_file, tmp_path, "--steps", 3, "--sampler", "nearest"))
    nearest = tifffile.imread(tmp_path / "far.tif")
    assert np.any(nearest != first)
    assert float(nearest.mean()) == pytest.approx(float(first.mean()), rel=0.02)


def test_colour_is_trained_on_its_luma_and_noise_is_carried(
    command: Command, tmp_path: Path
) -> None:
    image, noise = tmp_path / "colour.tif", tmp_path / "noise.json"
    colour = np.random.default_rng(1).integers(0, 255, (80, 90, 3)).astype(np.uint8)
    tifffile.imwrite(image, colour, photometric="rgb")
    noise.write_text(
        '{"schema": "standoff.noise/1", "gain_e_per_dn": 4.0, "read_noise_e": 8.0,'
        ' "black_level_dn": 0.0, "frames_averaged": 1}'
    )
    command.done(*_arguments(image, tmp_path, "--steps", 1, "--noise", noise))
    assert tifffile.imread(tmp_path / "far.tif").shape == (40, 45, 3)


def test_without_torch_one_line_says_what_to_install(
    command: Command, image_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "simulation.kernelgan._training", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)  # `import torch` fails from here on
    err = command.refused(1, *_arguments(image_file, tmp_path))
    assert "pip install standoff[kernelgan]" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "far.tif").exists()


def test_ctrl_c_leaves_nothing_half_written(
    command: Command, image_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("simulation.kernelgan._training.KernelGanTraining.step", interrupted)
    done = command(*_arguments(image_file, tmp_path))
    assert done.status == 130
    assert not (tmp_path / "kernels").exists()
    assert not (tmp_path / "far.tif").exists()


def test_an_image_too_small_for_a_training_is_one_line(command: Command, tmp_path: Path) -> None:
    image = tmp_path / "small.tif"
    tifffile.imwrite(image, TEXTURE[:40, :40])
    assert "use a larger image" in command.refused(1, *_arguments(image, tmp_path))


def test_the_settings_reach_the_training(
    command: Command, image_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[KernelGanSettings] = []

    def recorded(_: Any, settings: KernelGanSettings, __: Any) -> EstimatedKernel:
        seen.append(settings)
        weights = np.zeros((13, 13))
        weights[6, 6] = 1.0
        return EstimatedKernel(weights=weights)

    monkeypatch.setattr("standoff.library.simulated_photograph.estimate_kernel", recorded)
    options = ("--steps", 7, "--seed", 5, "--centre-crop")
    command.done(*_arguments(image_file, tmp_path, *options))
    command.done(*_arguments(image_file, tmp_path))
    assert seen == [
        KernelGanSettings(zoom=2.0, model=MODEL, steps=7, seed=5, is_centre_crop=True),
        KernelGanSettings(zoom=2.0, model=MODEL),
    ]
