"""What edges of one capture share: its focus, and the softness of the target at its scale."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
