"""Data sets of photographs with and without a change, for training one's own detector."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
