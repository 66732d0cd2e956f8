"""Many photographs: each done once, by this process or by others, and recorded."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
