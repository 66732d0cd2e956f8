"""The edges of a calibration as CSV, one row per edge."""

import csv
from io import StringIO

import numpy as np

from calibration.edges import SFR_FREQ_CY_PER_PX
from calibration.psf import PsfCalibration


def edge_csv(calibration: PsfCalibration) -> str:
    """Return the table: the entries of psf.json for each edge, then its contrast by frequency.

    Columns ``sfr_0.05`` to ``sfr_0.50`` are the contrast left at that many cy/px, by the e-SFR.
    An empty cell is a value that is not determined; flags share one cell, separated by spaces.
    """
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    freq = np.array(SFR_FREQ_CY_PER_PX)
    for number, edge in enumerate(calibration.edges):
        row = edge.model_dump()
        if number == 0:
            writer.writerow([*row, "is_used", *(f"sfr_{f:.2f}" for f in SFR_FREQ_CY_PER_PX)])
        row["flags"] = " ".join(row["flags"])
        sfr = [""] * freq.size if edge.esfr is None else [f"{v:.6f}" for v in edge.esfr.at(freq)]
        writer.writerow([*row.values(), "yes" if edge.is_used else "no", *sfr])
    return text.getvalue()
