"""Two photograph files compared: what the operator knows of their pose, and what is written."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
