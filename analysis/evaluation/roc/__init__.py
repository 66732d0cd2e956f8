"""Statistics of scores with and without a change: AUC, ROC, precision-recall, FROC, how sure."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
