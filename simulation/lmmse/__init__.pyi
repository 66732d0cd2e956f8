from .scene import SCENE_CORRELATION_PX as SCENE_CORRELATION_PX
from .terms import lmmse_terms as lmmse_terms

__all__ = ["SCENE_CORRELATION_PX", "lmmse_terms"]
