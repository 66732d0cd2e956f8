"""The kernels of the zoom-out models for any PSF, as banded matrices along either axis."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
