"""Writes report pages and figures, whole or not at all."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from standoff.library.files.output_files import require_pdf, write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_figure(path: Path, figure: "Figure") -> None:
    """Write a figure: as SVG if the file's suffix says so, else as PNG.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
    from analysis.reports import png_bytes, svg_bytes  # loads what plots

    write_file(path, svg_bytes(figure) if path.suffix.lower() == ".svg" else png_bytes(figure))


def write_page(path: Path, page: str) -> None:
    """Write one page: as PDF if the file's suffix says so, else as HTML.

    Raises
    ------
    ApplicationError
        If the file cannot be written, or the PDF extra is missing.
    """
    is_pdf = path.suffix.lower() == ".pdf"
    write_file(path, pdf_bytes(page) if is_pdf else page.encode("utf-8"))


def pdf_bytes(page: str) -> bytes:
    """Return a report page as the bytes of a PDF file.

    Raises
    ------
    ApplicationError
        If the extra is missing; the message says how to install it.
    """
    require_pdf()
    import weasyprint  # an optional dependency

    for name in ("weasyprint", "fontTools"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return bytes(weasyprint.HTML(string=page).write_pdf())
