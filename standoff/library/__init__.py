"""What ``import standoff`` gives: the measurements and simulations, on arrays or on files.

Wherever a person would try either, a function takes an array or the path of a file. The packages
hold the same functions on arrays alone.
"""

import lazy_loader as lazy

from standoff.shadowing import refuse_hidden_packages

refuse_hidden_packages()
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
