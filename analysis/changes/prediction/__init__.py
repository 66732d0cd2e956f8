"""The limit that a comparison is expected to have, and what a pair lost where it is another."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
