"""Photographs to calibrations: PSF, noise, geometry, and the registration of two views.

>>> from calibration import calibrate_psf, read_psf

Everything else is imported from its room: ``calibration.edges``, ``calibration.geometry`` ...
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
