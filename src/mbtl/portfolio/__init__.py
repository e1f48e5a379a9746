"""Portfolio: trained policies, the router that picks one per context, and their files."""

from mbtl.portfolio.choice import Choice
from mbtl.portfolio.heads import BoxHead, DiscreteHead
from mbtl.portfolio.mlp import MLPPolicy
from mbtl.portfolio.portfolio import Portfolio, load_portfolio

__all__ = ["BoxHead", "Choice", "DiscreteHead", "MLPPolicy", "Portfolio", "load_portfolio"]
