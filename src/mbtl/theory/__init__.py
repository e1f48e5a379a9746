"""Theory: exploration schedules, information gain, regret bounds, search-space elimination.

Four places of the printed mathematics slip (paper, sections 4 and appendix). The corrected form is
the default everywhere, `form="printed"` gives the printed one where it can be computed:

1. the printed search space subtracts the gap twice                    -> `search_space`
2. the proof of the restricted bound prints r_k where r_k^2 is needed  -> `restricted_regret_bound`
3. the harmonic sum is not <= log K but <= 1 + log K                   -> `sqrt_sum_bound`
4. the halving sum is not <= pi^2 / 6 but tends to 2                   -> `halving_sum_bound`

Empirical regret needs a full matrix and is `mbtl.objective.regret`.
"""

from mbtl.theory.bounds import (
    beta_experiments,
    beta_theory,
    confidence_constant,
    regret_bound,
    restricted_regret_bound,
)
from mbtl.theory.elimination import (
    Form,
    elimination_rate,
    halving_fractions,
    halving_sum_bound,
    longest_run,
    search_space,
    sqrt_fractions,
    sqrt_sum_bound,
    squared_sum,
)
from mbtl.theory.information import (
    InformationGain,
    information_gain,
    maximum_information_gain,
)

__all__ = [
    "Form",
    "InformationGain",
    "beta_experiments",
    "beta_theory",
    "confidence_constant",
    "elimination_rate",
    "halving_fractions",
    "halving_sum_bound",
    "information_gain",
    "longest_run",
    "maximum_information_gain",
    "regret_bound",
    "restricted_regret_bound",
    "search_space",
    "sqrt_fractions",
    "sqrt_sum_bound",
    "squared_sum",
]
