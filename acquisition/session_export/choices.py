"""Formats that callers choose from; imports no library."""

from typing import Literal

ExportFormat = Literal["ome-zarr", "ome-tiff", "nexus"]

EXPORT_ENDINGS: dict[ExportFormat, tuple[str, ...]] = {
    "ome-zarr": (".ome.zarr", ".zarr"),
    "ome-tiff": (".ome.tif", ".ome.tiff"),
    "nexus": (".nxs", ".nx", ".h5", ".hdf5"),
}
"""How a name must end, for others' readers to know the format by."""
