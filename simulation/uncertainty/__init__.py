"""How far a simulated follow-up may be from the real one, pixel by pixel."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
