"""Writes figures, as PNG or SVG, whole or not at all."""

from pathlib import Path

from matplotlib.figure import Figure

from analysis.reports import png_bytes, svg_bytes
from standoff.library.files.output_files import write_file


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure: as SVG if the file's suffix says so, else as PNG.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
    write_file(path, svg_bytes(figure) if path.suffix.lower() == ".svg" else png_bytes(figure))
