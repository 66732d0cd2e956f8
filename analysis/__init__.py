"""Evaluate and use simulations: validation, detectability, pose, changes.

Reports of all of it are in ``analysis.reports``.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
