"""Image files as photographs with linear levels, and the two examples that come with standoff."""

from dataclasses import dataclass
from pathlib import Path

from acquisition.photographs import Encoding, Photograph, ReadOptions, read_photograph
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import FilePath, path_of


@checked
def reading(
    encoding: str = "auto",
    *,
    page: int | None = None,
    mean: bool = False,
    white_level: float | None = None,
) -> ReadOptions:
    """Return options for reading images, for the functions that take ``reading=``.

    They apply to arrays as well as to files: the levels of an array are treated as those of a
    file, and the pages of a stack are along its first axis.

    Parameters
    ----------
    encoding
        How the levels follow from the light: ``linear``, ``srgb``, ``gamma:G``, or ``auto``: as
        the file states, or as is usual for its format; arrays are linear.
    page
        Number of the image to take from a stack, from 1.
    mean
        Whether a stack is one capture: its mean is taken, with the temporal variance.
    white_level
        Level, as it is stored, at which images are clipped; by default the level that a file
        states, or the largest that its numbers can hold. For floats, by default the level at which
        they were visibly cut off, if any.

    Returns
    -------
    ReadOptions
        The options, for ``reading=``.

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
            f"expected auto, linear, srgb or gamma:G such as gamma:2.2, got {encoding!r}",
            argument="encoding",
        ) from error
    try:
        return ReadOptions(encoding=known, page=page, is_mean=mean, white_level=white_level)
    except ValueError as error:
        raise ArgumentError(str(error)) from error


@checked
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
        The photograph; ``numpy.asarray`` of it gives levels linear in light, in which white keeps
        the level that it has in the file.

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
    return read_photograph(path_of(path, "path"), reading(encoding, page=page, mean=mean))


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ExamplePhotographs(Shown):
    """Paths of two photographs from two distances, and of two from one place, before and after."""

    nearer: Path
    further: Path
    before: Path
    after: Path


@checked
def example_photographs() -> ExamplePhotographs:
    """Find the photographs that come with standoff: a postcard from two distances, and a lantern.

    Returns
    -------
    ExamplePhotographs
        The paths ``nearer`` and ``further`` of 8-bit sRGB PNG files of shape ``(440, 520, 3)``.
        Both are on the pixel grid of the nearer one, and nothing changed between them. ``before``
        and ``after`` are JPEG files of shape ``(336, 304, 3)``: a roof with a paper lantern, and
        the same photograph from which the lantern was taken away.

    Raises
    ------
    ApplicationError
        If the installation lacks them.

    Examples
    --------
    >>> pair = standoff.example_photographs()
    >>> found = standoff.find_changes(pair.before, pair.after)
    >>> [change.what for change in found.summary.changes]
    ['gone']

    References
    ----------
    C. Chen, Z. Xiong, X. Tian, Z.-J. Zha, F. Wu, "Camera Lens Super-Resolution", CVPR 2019: City100
    (MIT licence). The lantern: IOPaint (Apache licence 2.0). ``README.md`` beside the photographs
    says what was done to them.
    """
    folder = Path(__file__).parents[1] / "example_photographs"
    pair = ExamplePhotographs(
        nearer=folder / "nearer.png",
        further=folder / "further.png",
        before=folder / "lantern-before.jpg",
        after=folder / "lantern-after.jpg",
    )
    for path in (pair.nearer, pair.further, pair.before, pair.after):
        if not path.is_file():
            raise ApplicationError(
                f"{path.name} is not in this installation; install standoff again"
            )
    return pair
