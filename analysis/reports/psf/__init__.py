"""The report of a PSF: verdict and headline, edges with their curves, the field, the history."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
