"""What a planned session will know: plan, bench and PSF as a caller gives them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
