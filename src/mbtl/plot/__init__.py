"""Pictures: every function takes matplotlib axes or makes its own, and returns the axes.

    ax = mbtl.plot.curve(study)
    ax.figure.savefig("curve.pdf")

Numbers come from studies, portfolios, matrices and comparisons as they are; nothing is computed
here that a table does not show. No display is needed, and no picture is shown by itself.
"""

from mbtl.plot.curves import comparison, curve
from mbtl.plot.maps import model, policy_map
from mbtl.plot.matrices import matrix
from mbtl.plot.style import save, style

__all__ = ["comparison", "curve", "matrix", "model", "policy_map", "save", "style"]
