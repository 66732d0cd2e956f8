"""The best linear resampler from the pixels of a reference to those of its follow-up."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
