"""Sharpness of measured edges: in units of use, over the field, by colour, against limits."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
