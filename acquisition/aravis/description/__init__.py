"""The description that a camera serves of itself, read and checked before Aravis evaluates it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
