"""The report of changes: both photographs to blink, the list, and a series as a time line."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
