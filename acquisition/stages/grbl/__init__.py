"""A stage on a Grbl 1.1 or grblHAL controller."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
