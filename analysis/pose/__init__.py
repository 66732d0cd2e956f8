"""How far a camera may move, and whether a follow-up's pose is good enough."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
