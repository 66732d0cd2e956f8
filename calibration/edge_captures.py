"""The edge captures of a session as input of the PSF calibration."""

from collections.abc import Iterator

import numpy as np

from acquisition.record import CaptureRecord
from acquisition.session import Session
from calibration.errors import NoEdgeError
from calibration.noise_model import fit_level_noise
from calibration.psf_calibration import EdgeImage

__all__ = ["edge_images", "edge_records"]

EDGE_KINDS = ("edge", "board")


def edge_records(session: Session) -> list[CaptureRecord]:
    """Return the captures that a PSF can be measured on.

    Raises
    ------
    NoEdgeError
        If the session has none.
    """
    records = [record for record in session.records if record.kind in EDGE_KINDS]
    if not records:
        raise NoEdgeError(f"{session.path}: the session has no capture of kind edge or board")
    return records


def edge_images(session: Session) -> Iterator[EdgeImage]:
    """Load the edge captures one by one, each with its own noise.

    The noise is fitted to the temporal variance that the capture stores; a single photograph
    has none, and the edge fit then estimates it from its residuals.

    Raises
    ------
    NoEdgeError
        If the session has no edge capture.
    SessionError
        If a capture file is missing or changed.
    """
    for record in edge_records(session):
        images = session.load(record)
        noise = None
        if images.variance_dn2 is not None:
            single = fit_level_noise(images.mean_dn, images.variance_dn2, record.max_level_dn)
            noise = single.averaged(record.frames_used)
        yield EdgeImage(
            name=record.file,
            image_dn=images.mean_dn.astype(np.float64),
            capture=record.index,
            height_mm=record.height_mm,
            noise=noise,
            saturation_dn=record.max_level_dn,
        )
