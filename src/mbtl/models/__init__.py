"""Models of what training and transfer will give.

Here is the paper's Gaussian process of the training performance. Of transfer there are a Gaussian
process over pairs (`mbtl.models.transfer_gp`), straight lines (`mbtl.models.linear_trend`) and the
generalisation gap of SD-MBTL (`mbtl.models.directional_gap`).
"""

from mbtl.models.gp import FittedGP, GPSettings, fit_gp

__all__ = ["FittedGP", "GPSettings", "fit_gp"]
