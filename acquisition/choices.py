"""Names and bounds that callers of this package choose from; imports no library."""

from typing import Literal, get_args

CaptureKind = Literal["edge", "texture", "chart", "board", "flat", "dark"]

FocusMeasure = Literal["squared-gradient", "tenengrad", "brenner", "laplacian"]

StageAction = Literal["status", "home", "move", "stop", "unlock"]

FEWEST_POSITIONS = 7
"""Fewest positions of a focus sweep: its curve has five parameters, two more test the fit."""

ExportFormat = Literal["ome-zarr", "ome-tiff", "nexus"]

EXPORT_ENDINGS: dict[ExportFormat, tuple[str, ...]] = {
    "ome-zarr": (".ome.zarr", ".zarr"),
    "ome-tiff": (".ome.tif", ".ome.tiff"),
    "nexus": (".nxs", ".nx", ".h5", ".hdf5"),
}
"""How a name must end, for others' readers to know the format by."""

Channel = Literal["luma", "red", "green", "blue"]

Pattern = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
"""Colours of the first two pixels of the first row, then of the second row (as GenICam, EMVA)."""
