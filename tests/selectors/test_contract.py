import pytest

from mbtl.selectors import MBTL, get_selector, selector_names
from mbtl.testing.selectors import SelectorContract


class TestSelectors(SelectorContract):
    @pytest.fixture(
        params=[*selector_names(), MBTL(gap="fitted"), MBTL(incumbent="predicted")],
        ids=[*selector_names(), "mbtl-fitted", "mbtl-predicted"],
    )
    def selector(self, request):
        return get_selector(request.param)
