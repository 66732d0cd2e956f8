"""What a person sees in a terminal: options, tables, progress, prompts."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
