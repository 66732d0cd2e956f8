"""A report as PDF, where the ``pdf`` extra is installed."""

import logging

from standoff.errors import ApplicationError

__all__ = ["pdf_bytes", "require_pdf"]


def require_pdf() -> None:
    """Check that PDF files can be made.

    Raises
    ------
    ApplicationError
        If the extra is missing; the message says how to install it.
    """
    try:
        import weasyprint  # noqa: F401  # an optional dependency
    except (ImportError, OSError) as error:  # OSError: its system libraries are missing
        raise ApplicationError(
            f"a PDF report needs WeasyPrint ({error}): pip install standoff[pdf]"
        ) from error


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
