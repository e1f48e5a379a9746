"""Models of what training and transfer will give: Gaussian process and generalisation gap."""

from mbtl.models.gap import FittedGap, GapModel, LinearGap, predicted_rows
from mbtl.models.gp import FittedGP, GPSettings
from mbtl.models.gp_fit import fit_gp

__all__ = [
    "FittedGP",
    "FittedGap",
    "GPSettings",
    "GapModel",
    "LinearGap",
    "fit_gp",
    "predicted_rows",
]
