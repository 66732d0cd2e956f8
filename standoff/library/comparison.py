"""Two photographs of one scene: where the second was taken from, and what changed."""

from analysis.changes import ChangeOptions, ChangeResult, find_changes as changes_between
from analysis.choices import FALSE_ALARMS
from calibration.registration import (
    FeatureMatches as FeatureMatches,
    Registration,
    RegistrationHints as RegistrationHints,
    register as registered,
)
from standoff.library.inputs import (
    ImageLike,
    NoiseLike,
    PsfLike,
    camera_noise,
    camera_psf,
    grey_image,
    whole_frame_psf,
)


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
    """
    near, far = grey_image(reference, "reference"), grey_image(followup, "followup")
    return registered(near, far, None if psf is None else whole_frame_psf(psf).gaussian, hints)


def find_changes(
    reference: ImageLike,
    followup: ImageLike,
    psf: PsfLike | None = None,
    *,
    noise: NoiseLike | None = None,
    false_alarms: float = FALSE_ALARMS,
    hints: RegistrationHints | None = None,
) -> ChangeResult:
    """Find what changed between two photographs that their poses do not explain.

    Parameters
    ----------
    reference, followup
        Arrays or files; the follow-up is the later one, from nearer or further away.
    psf
        The camera's PSF; without it the blur between the photographs is fitted to them.
    noise
        Noise of both captures, or the path of a noise.json; without it the noise is fitted.
    false_alarms
        Expected number of pixels flagged by chance per frame.
    hints
        What is known of the pose beforehand, as in ``register``; pixels that do not count are not
        compared either.

    Returns
    -------
    ChangeResult
        Its ``summary.changes`` is the list; the maps are on the follow-up's pixels.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    RegistrationError
        If the two cannot be aligned.
    AnalysisError
        If they overlap too little.
    """
    near, far = grey_image(reference, "reference"), grey_image(followup, "followup")
    options = ChangeOptions(
        noise=camera_noise(noise),
        false_alarms=false_alarms,
        hints=hints,
        left_out=None if hints is None else hints.left_out,
    )
    frame = (near.shape[1], near.shape[0]) if near.shape == far.shape else None
    known = None if psf is None else camera_psf(psf, frame, "matched")
    return changes_between(near, far, known, options)
