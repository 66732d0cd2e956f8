"""The statistical error of a calibrated PSF, as steps that a simulation can take."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
