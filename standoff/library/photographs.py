"""Image files as photographs with linear levels."""

from standoff.errors import ArgumentError
from standoff.library.inputs import FilePath, path_of
from standoff.photographs import Encoding, Photograph, ReadOptions, read_image as read


def reading(encoding: str = "auto", *, page: int | None = None, mean: bool = False) -> ReadOptions:
    """Say how image files are read, for the functions that take ``reading=``.

    Parameters
    ----------
    encoding
        How their levels follow from light: ``auto`` (as the file states, or as is usual for its
        format), ``linear``, ``srgb`` or ``gamma:G``.
    page
        Which image of a stack, from 1.
    mean
        Whether a stack is one capture: its mean, with the temporal variance.

    Returns
    -------
    ReadOptions
        For ``reading=``.

    Raises
    ------
    ArgumentError
        If the encoding is unknown, or both ``page`` and ``mean`` are given.

    Examples
    --------
    >>> second = standoff.reading("linear", page=2)
    >>> standoff.simulate("stack.tif", zoom=2, psf="psf.json", reading=second).image.shape
    (120, 160)
    """
    try:
        known = None if encoding == "auto" else Encoding(name=encoding)
    except ValueError as error:
        raise ArgumentError(
            f"expected auto, linear, srgb or gamma:G such as gamma:2.2, got {encoding!r}"
        ) from error
    try:
        return ReadOptions(encoding=known, page=page, is_mean=mean)
    except ValueError as error:
        raise ArgumentError(str(error)) from error


def read_image(
    path: FilePath, *, encoding: str = "auto", page: int | None = None, mean: bool = False
) -> Photograph:
    """Read an image file: TIFF, PNG, JPEG, camera raw, OpenEXR, FITS and more.

    Parameters
    ----------
    path
        The file.
    encoding, page, mean
        As in ``reading``.

    Returns
    -------
    Photograph
        ``numpy.asarray`` of it gives the levels linear in light, with the file's white.

    Raises
    ------
    TypeError
        If ``path`` is not a path.
    ArgumentError
        If the encoding is unknown, or both ``page`` and ``mean`` are given.
    ImageFileError
        If the file cannot be read; the message says why.

    Examples
    --------
    >>> photograph = standoff.read_image("before.tif")
    >>> photograph.encoding.name, photograph.grey_dn.shape
    ('linear', (240, 320))
    """
    return read(path_of(path, "path"), reading(encoding, page=page, mean=mean))
