from .best_linear import lmmse_terms as lmmse_terms
from .matched import spline_prefilter as spline_prefilter, spline_terms as spline_terms
from .scene import SCENE_CORRELATION_PX as SCENE_CORRELATION_PX, SeenScene as SeenScene
