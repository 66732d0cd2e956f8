"""Two photographs of one scene: where the second was taken from, and what changed."""

from analysis.changes import ChangeOptions, ChangeResult, find_changes as changes_between
from analysis.choices import FALSE_ALARMS
from calibration.registration import Registration, register as registered
from standoff.library.inputs import (
    ImageLike,
    NoiseLike,
    PsfLike,
    camera_noise,
    camera_psf,
    grey_image,
    whole_frame_psf,
)


def register(reference: ImageLike, followup: ImageLike, psf: PsfLike | None = None) -> Registration:
    """Return the pose of a follow-up relative to its reference, as a homography.

    Parameters
    ----------
    reference, followup
        Arrays or files; the follow-up is the one from further away.
    psf
        The camera's PSF; without it the reference is simulated by ``bicubic``.

    Returns
    -------
    Registration
        ``matrix`` maps follow-up pixels ``(x, y, 1)`` to reference pixels.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    RegistrationError
        If the two cannot be aligned; ``reason`` and ``at_fault`` say why.
    """
    near, far = grey_image(reference, "reference"), grey_image(followup, "followup")
    return registered(near, far, None if psf is None else whole_frame_psf(psf).gaussian)


def find_changes(
    reference: ImageLike,
    followup: ImageLike,
    psf: PsfLike,
    *,
    noise: NoiseLike | None = None,
    false_alarms: float = FALSE_ALARMS,
) -> ChangeResult:
    """Find what changed between two photographs that their poses do not explain.

    Parameters
    ----------
    reference, followup
        Arrays or files; the follow-up is the later one, from further away.
    psf
        The camera's PSF.
    noise
        Noise of both captures, or the path of a noise.json; without it the noise is fitted.
    false_alarms
        Expected number of pixels flagged by chance per frame.

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
    options = ChangeOptions(noise=camera_noise(noise), false_alarms=false_alarms)
    frame = (near.shape[1], near.shape[0]) if near.shape == far.shape else None
    return changes_between(near, far, camera_psf(psf, frame, "matched"), options)
