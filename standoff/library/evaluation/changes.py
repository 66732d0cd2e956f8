"""Changes as the caller gives them: a picture with alpha, or photographs of later with masks."""

from os import PathLike
from pathlib import Path

import cv2
import numpy as np

from acquisition.photographs import ReadOptions, read_photograph
from acquisition.printable import on_one_line
from analysis.errors import RefusedPhotographError
from analysis.evaluation import LaterScene, Patch
from simulation.arguments import checked
from simulation.arrays import FloatArray
from standoff.errors import ApplicationError
from standoff.library.call import FilePath
from standoff.library.swept_photographs import colour_scene_image

_SAME_NAME = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".exr", ".dng")


@checked
def patch_of(path: FilePath, reading: ReadOptions | None = None) -> Patch:
    """Return a picture as a change; where a PNG or TIFF has an alpha, it says what is covered.

    Levels are read as those of photographs; without an alpha all is covered.

    Parameters
    ----------
    path
        The picture.
    reading
        How its levels are read; see ``standoff.reading``.

    Returns
    -------
    Patch
        For ``EvaluationTask(change=...)``.

    Raises
    ------
    ApplicationError
        If it cannot be used.
    ImageFileError
        If it cannot be read.

    Examples
    --------
    >>> crack = standoff.patch_of("crack.png")
    >>> task = standoff.EvaluationTask(change=crack, contrasts_dn=(1.0,))
    """
    file = Path(path)
    levels = np.asarray(read_photograph(file, reading or ReadOptions()).shown_dn, np.float64)
    stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    alpha: FloatArray = np.ones(levels.shape[:2])
    if stored is not None and stored.ndim == 3 and stored.shape[2] == 4:
        full = {"uint8": 255.0, "uint16": 65535.0}.get(stored.dtype.name, 1.0)
        alpha = np.asarray(stored[:, :, 3] / full, np.float64)
    try:
        return Patch(levels_dn=levels, alpha=alpha, name=on_one_line(file.name))
    except ValueError as error:
        raise ApplicationError(f"{on_one_line(file)}: {error}") from error


def later_scene(after: Path, masks: Path, options: ReadOptions, photograph: Path) -> LaterScene:
    """Read the later photograph and the mask that have a photograph's name.

    Raises
    ------
    RefusedPhotographError
        If one is missing, or they do not fit together.
    """
    later = colour_scene_image(options, _named_as(photograph, after, "photograph of later"))
    mask = colour_scene_image(options, _named_as(photograph, masks, "mask"))
    try:
        after_dn = later.grey_dn if later.colours is None else later.colours()
        return LaterScene(after_dn=after_dn, mask=mask.grey_dn > 0)
    except ValueError as error:
        raise RefusedPhotographError(str(error)) from error


def _named_as(photograph: Path, folder: str | PathLike[str], kind: str) -> Path:
    same = Path(folder) / photograph.name
    if same.is_file():
        return same
    for suffix in _SAME_NAME:
        if same.with_suffix(suffix).is_file():
            return same.with_suffix(suffix)
    raise RefusedPhotographError(
        f"there is no {kind} of its name, {photograph.stem}, in {on_one_line(folder)}"
    )
