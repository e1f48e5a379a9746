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


@pytest.fixture(params=["memory", "sqlite", "postgres"])
def storage(request, tmp_path):
    if request.param == "postgres":
        return request.getfixturevalue("server").url
    return None if request.param == "memory" else tmp_path / "study.db"
