"""Two photographs brought to one sharpness, and the kernel and the scatter fitted between them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
