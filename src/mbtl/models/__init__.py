"""Models of what training and transfer will give: Gaussian process and generalisation gap."""

from mbtl.models.gp import FittedGP, GPSettings, fit_gp

__all__ = ["FittedGP", "GPSettings", "fit_gp"]
