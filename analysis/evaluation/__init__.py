"""How well a change detector does on pairs from other poses, made from the user's photographs."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
