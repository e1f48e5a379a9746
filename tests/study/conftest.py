"""One PostgreSQL server for all tests of studies, where it is installed."""

import pytest
from postgres import Server, missing


@pytest.fixture(scope="session")
def server():
    """Empty at first."""
    if reason := missing():
        pytest.skip(reason)
    with Server() as started:
        yield started
