"""The two photographs that come with standoff."""

from dataclasses import dataclass
from pathlib import Path

from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.errors import ApplicationError


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ExamplePhotographs(Shown):
    """Paths of two photographs of one scene, from two distances."""

    nearer: Path
    further: Path


@checked
def example_photographs() -> ExamplePhotographs:
    """Find the two photographs that come with standoff: a postcard, from two distances.

    Returns
    -------
    ExamplePhotographs
        The paths ``nearer`` and ``further``, of 8-bit sRGB PNG files of shape ``(440, 520, 3)``.
        Both are on the pixels of the nearer one, and nothing changed between them.

    Raises
    ------
    ApplicationError
        If the installation lacks them.

    Examples
    --------
    >>> pair = standoff.example_photographs()
    >>> found = standoff.find_changes(pair.nearer, pair.further)

    References
    ----------
    C. Chen, Z. Xiong, X. Tian, Z.-J. Zha, F. Wu, "Camera Lens Super-Resolution", CVPR 2019: City100
    (MIT licence). ``README.md`` beside the photographs says what was done to them.
    """
    folder = Path(__file__).parents[1] / "example_photographs"
    pair = ExamplePhotographs(nearer=folder / "nearer.png", further=folder / "further.png")
    for path in (pair.nearer, pair.further):
        if not path.is_file():
            raise ApplicationError(
                f"{path.name} is not in this installation; install standoff again"
            )
    return pair
