"""Portfolio: trained policies, the router that picks one per context, and their files."""

from mbtl.portfolio.adaptive import Adaptive
from mbtl.portfolio.mlp import BoxHead, DiscreteHead, MLPPolicy
from mbtl.portfolio.portfolio import Portfolio, load_portfolio
from mbtl.portfolio.router import Choice
from mbtl.portfolio.served import Served
from mbtl.portfolio.signs import Signs

__all__ = [
    "Adaptive",
    "BoxHead",
    "Choice",
    "DiscreteHead",
    "MLPPolicy",
    "Portfolio",
    "Served",
    "Signs",
    "load_portfolio",
]
