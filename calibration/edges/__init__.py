"""Find edges in photographs, fit them on the raw pixels, and measure their e-SFR."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
