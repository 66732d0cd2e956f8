"""A bench camera's PSF, scenes from further away, and how detectable a change still is.

The functions here take an array or the path of a file; ``docs/library.md`` shows how to use them.
Nothing is imported before it is used.
"""

import lazy_loader as lazy

__version__ = "1.0.0"

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
