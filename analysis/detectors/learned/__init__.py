"""A small network that learns to find changes, with PyTorch; the extra ``learned`` brings it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
