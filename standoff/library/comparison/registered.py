"""Where a photograph was taken from, relative to another one."""

from acquisition.photographs import ReadOptions
from calibration.registration import (
    FeatureMatches as FeatureMatches,
    Registration,
    RegistrationHints as RegistrationHints,
    RegistrationReference,
    leaving_out,
    register as registered,
)
from simulation.arguments import checked
from standoff.library.call import Call
from standoff.library.inputs import (
    ImageLike,
    PsfLike,
    photograph,
    with_white_level,
)
from standoff.library.psf import camera_psf


@checked
def register(
    reference: ImageLike,
    followup: ImageLike,
    psf: PsfLike | None = None,
    *,
    hints: RegistrationHints | None = None,
    white_level: float | None = None,
    reading: ReadOptions | None = None,
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
    white_level
        Level, as it is stored, at which both are clipped: pixels there do not count. Plateaus do
        not in any case, nor do pixels that an array masks.
    reading
        How the two are read; see ``standoff.reading``.

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
    options = with_white_level(reading, white_level)
    near, far = (
        photograph(reference, "reference", options),
        photograph(followup, "followup", options),
    )
    known = None if psf is None else camera_psf(Call("register"), psf).gaussian
    is_stated = options.white_level is not None
    return registered(
        RegistrationReference.of(near.filled.grey_dn, near.not_measured(is_clipped=is_stated)),
        far.filled.grey_dn,
        known,
        leaving_out(hints, far.not_measured(is_clipped=is_stated)),
    )
