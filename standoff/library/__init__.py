"""What ``import standoff`` gives: the measurements and simulations, on arrays or on files.

Wherever a person would try either, a function takes an array or the path of a file. The packages
hold the same functions on arrays alone.
"""

from standoff.front import front_of

__getattr__, __dir__, __all__ = front_of(__name__, __file__)
