"""A session in others' formats: OME-TIFF, OME-Zarr and NeXus, written capture by capture."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
