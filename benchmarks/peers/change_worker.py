"""Runs an image subtraction of another project in that project's own environment.

    PYTHON benchmarks/peers/change_worker.py {sfft,properimage} IN.npz OUT.npz

``IN.npz`` holds ``reference``, on the follow-up's pixels, and ``followup``; ``OUT.npz`` gets their
``difference``. Imports nothing of this project, whose requirements the peers do not share.
"""

import sys
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

_HALF_WIDTH_PX = 3
_SPATIAL_ORDER = 2

_Image = NDArray[np.float64]


def sfft(reference: _Image, followup: _Image) -> _Image:
    """Hu, Wang, Chen, Yang (2022): kernel and light of order 2, in the space of frequencies."""
    configure = import_module("sfft.sfftcore.SFFTConfigure").SingleSFFTConfigure.SSC
    subtract = import_module("sfft.sfftcore.SFFTSubtract").GeneralSFFTSubtract.GSS
    common: dict[str, object] = {
        "BACKEND_4SUBTRACT": "Numpy",
        "NUM_CPU_THREADS_4SUBTRACT": 1,
        "VERBOSE_LEVEL": 0,
    }
    setting = configure(
        NX=reference.shape[0],
        NY=reference.shape[1],
        KerHW=_HALF_WIDTH_PX,
        KerPolyOrder=_SPATIAL_ORDER,
        BGPolyOrder=_SPATIAL_ORDER,
        ConstPhotRatio=False,
        **common,
    )
    images = {
        "PixA_I": reference,
        "PixA_J": followup,
        "PixA_mI": reference,
        "PixA_mJ": followup,
    }
    return np.asarray(subtract(SFFTConfig=setting, **images, **common)[1], dtype=np.float64)


def _properimage(reference: _Image, followup: _Image) -> _Image:
    """Zackay, Ofek, Gal-Yam (2016) as ProperImage does it, with PSFs from what it finds."""
    subtract = import_module("properimage.operations").subtract
    difference = subtract(ref=reference, new=followup, align=False)[0]
    return np.asarray(np.ma.filled(difference.real, 0.0), dtype=np.float64)


def main() -> None:
    """Run the peer that the arguments name."""
    name, source, target = sys.argv[1:]
    given = np.load(source)
    images = (np.ascontiguousarray(given[key]) for key in ("reference", "followup"))
    difference = {"sfft": sfft, "properimage": _properimage}[name](*images)
    np.savez(target, difference=difference)


if __name__ == "__main__":
    main()
