from pathlib import Path

import numpy as np
import pytest

from acquisition.averaging import average_frames
from acquisition.bench import load_bench
from calibration.edges import EdgeImage
from calibration.noise import fit_level_noise
from calibration.psf import Estimate, psf_of_images
from hil_mocks import SimulatedBench
from standoff.shipped_configs import shipped_config
from tests.standoff.conftest import Command


def test_the_demo_opens_no_real_device(command: Command, tmp_path: Path) -> None:
    words = ("camera.driver=aravis", "camera.address=127.0.0.1", "stage.driver=manual")
    settings = [part for word in words for part in ("--set", word)]
    done = command("demo", "--out", tmp_path / "demo", *settings)
    assert done.status == 1
    assert done.err == "standoff: the demo runs on the simulated bench only\n"


def test_the_demo_refuses_a_directory_it_cannot_write(command: Command, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    done = command("demo", "--out", tmp_path / "file" / "demo")
    assert done.status == 1
    assert "file is not a folder" in done.err


@pytest.mark.slow
@pytest.mark.usefixtures("widths_alone")
@pytest.mark.parametrize("half", [0, 1])
def test_the_95_percent_intervals_contain_the_truth(half: int) -> None:
    # Ten seeds each of the demo's edges at one height, on a quarter of its sensor; a correct
    # interval misses the truth more than twice in ten with probability 0.012, so the two halves
    # together stand for 18 of 20.
    inside = np.zeros(3, dtype=int)
    for seed in range(10 * half + 1, 10 * half + 11):
        quarter = {"simulated.width_px": 390, "simulated.height_px": 290}
        config = load_bench(shipped_config("demo_bench.toml"), {"simulated.seed": seed} | quarter)
        bench = SimulatedBench(config)
        calibration = psf_of_images(_edges(bench))
        assert config.simulated is not None
        truths = (
            config.simulated.optical_sigma_x_px,
            config.simulated.optical_sigma_y_px,
            config.simulated.optical_rho,
        )
        estimates = (
            calibration.optical.sigma_x_px,
            calibration.optical.sigma_y_px,
            calibration.optical.rho,
        )
        inside += [_contains(e, t) for e, t in zip(estimates, truths, strict=True)]
    assert np.all(inside >= 8)


def _contains(estimate: Estimate | None, truth: float) -> bool:
    assert estimate is not None
    return estimate.low <= truth <= estimate.high


def _edges(bench: SimulatedBench) -> list[EdgeImage]:
    bench.stage.home(60.0)
    bench.stage.move_to(280.0, 60.0)
    images = []
    for turn_deg in (5.0, 50.0, 95.0, 140.0):
        bench.place("edge", turn_deg)
        averaged = average_frames(bench.camera, 10, clock=lambda: bench.clock.now_s)
        single = fit_level_noise(averaged.mean_dn, averaged.variance_dn2, 4095.0)
        images.append(
            EdgeImage(
                name=f"{turn_deg:g}",
                image_dn=averaged.mean_dn.astype(np.float64),
                noise=single.averaged(10),
                saturation_dn=4095.0,
            )
        )
    return images
