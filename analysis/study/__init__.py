"""What a planned capture session will know, by Fisher information, and what it would take."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
