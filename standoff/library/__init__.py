"""The public functions of ``import standoff``: measurements and simulations on arrays or files.

A function that takes an image takes an array as well as the path of a file. The packages hold the
same functions for arrays only.
"""

from standoff.front import front_of

__getattr__, __dir__, __all__ = front_of(__name__, __file__)
