"""The remark on a raw mosaic that was saved as a grey picture, on the command line."""

from pathlib import Path

import numpy as np
import tifffile

from tests.standoff.conftest import Command


def test_it_is_said_and_not_to_whom_it_is_known(command: Command, tmp_path: Path) -> None:
    """A grey file of a colour camera counted as a grey photograph, without a word."""
    rows, cols = np.mgrid[:160, :160].astype(float)
    light = 300 + 1350 * (1 + np.tanh((cols - 80 + 0.1 * rows - 8) / 1.2))
    light += np.random.default_rng(1).normal(0, 4, light.shape)
    gains = np.tile([[0.6, 1.0], [1.0, 0.75]], (80, 80))
    path = tmp_path / "edge.tif"
    tifffile.imwrite(path, np.rint(light * gains).astype(np.uint16))
    out = ("--out", tmp_path / "psf.json", "--force")
    assert "raw mosaic" in command("calibrate", path, *out).err
    assert "raw mosaic" not in command.done("calibrate", path, "--bayer", "RGGB", *out).err
