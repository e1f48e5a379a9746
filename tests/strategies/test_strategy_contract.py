"""What every strategy over trainings owes."""

import pytest

from mbtl.strategies import get_strategy
from mbtl.testing.strategies import StrategyContract


@pytest.mark.parametrize("strategy", ["auto", "all-first", "one-policy"], indirect=True)
class TestOurs(StrategyContract):
    @pytest.fixture
    def strategy(self, request):
        return get_strategy(request.param)
