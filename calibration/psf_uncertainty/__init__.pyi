from .steps import focus_scatter_px2 as focus_scatter_px2, psf_steps as psf_steps
