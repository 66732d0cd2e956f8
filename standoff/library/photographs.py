"""Image files as photographs with linear levels."""

from standoff.library.inputs import FilePath, path_of
from standoff.photographs import Encoding, Photograph, ReadOptions, read_image as read


def read_image(
    path: FilePath, *, encoding: str = "auto", page: int | None = None, mean: bool = False
) -> Photograph:
    """Read an image file: TIFF, PNG, JPEG, camera raw, OpenEXR, FITS and more.

    Parameters
    ----------
    path
        The file.
    encoding
        How its levels follow from light: ``auto`` (as the file states, or as is usual for its
        format), ``linear``, ``srgb`` or ``gamma:G``.
    page
        Which image of a stack, from 1.
    mean
        Whether a stack is one capture: its mean, with the temporal variance.

    Returns
    -------
    Photograph
        ``numpy.asarray`` of it gives the levels linear in light, with the file's white.

    Raises
    ------
    TypeError
        If ``path`` is not a path.
    ValueError
        If the encoding is unknown, or both ``page`` and ``mean`` are given.
    ImageFileError
        If the file cannot be read; the message says why.
    """
    options = ReadOptions(
        encoding=None if encoding == "auto" else Encoding(name=encoding), page=page, is_mean=mean
    )
    return read(path_of(path, "path"), options)
