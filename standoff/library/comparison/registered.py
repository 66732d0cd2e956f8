"""Where a photograph was taken from, relative to another one."""

from calibration.registration import (
    FeatureMatches as FeatureMatches,
    Registration,
    RegistrationHints as RegistrationHints,
    register as registered,
)
from standoff.library.call import Call
from standoff.library.inputs import (
    ImageLike,
    PsfLike,
    grey_image,
)
from standoff.library.psf import camera_psf


def register(
    reference: ImageLike,
    followup: ImageLike,
    psf: PsfLike | None = None,
    *,
    hints: RegistrationHints | None = None,
) -> Registration:
    """Return the pose of a follow-up relative to its reference.

    Parameters
    ----------
    reference, followup
        Arrays or files; either may be the nearer one.
    psf
        The camera's PSF; without it, one of 0.65 px is assumed.
    hints
        What is known of the pose beforehand: the ratio of the distances, an approximate homography
        or pairs of points, and follow-up pixels that do not count.

    Returns
    -------
    Registration
        ``matrix`` maps follow-up pixels ``(x, y, 1)`` to reference pixels; ``warnings`` are
        sentences on what to check.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    RegistrationError
        If the two cannot be aligned; ``reason`` and ``at_fault`` say why.

    Examples
    --------
    >>> pose = standoff.register("before.tif", "after.tif", "psf.json")
    >>> round(pose.zoom, 3)
    1.188
    """
    near, far = grey_image(reference, "reference"), grey_image(followup, "followup")
    return registered(
        near, far, None if psf is None else camera_psf(Call("register"), psf).gaussian, hints
    )
