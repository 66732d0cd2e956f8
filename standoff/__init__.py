"""A bench camera's PSF, scenes from further away, and how detectable a change still is.

The functions here take an array or the path of a file; ``docs/library.md`` shows how to use them.
Each name lies in the room that makes it, and nothing is imported before it is used.
"""

from standoff.front import front_of

__version__ = "1.1.0"

__getattr__, __dir__, __all__ = front_of(__name__, __file__)
