"""``standoff benchmark``: data sets with their truth, and the scores of programs on them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
