import pytest

from mbtl.selectors import get_selector, selector_names
from mbtl.testing.selectors import SelectorContract


class TestSelectors(SelectorContract):
    @pytest.fixture(params=selector_names())
    def selector(self, request):
        return get_selector(request.param)
