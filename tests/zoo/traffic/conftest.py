import pytest


@pytest.fixture
def opened():
    """Simulations and environments that are closed at the end of the test."""
    made = []

    def opened(one):
        made.append(one)
        return one

    yield opened
    for one in made:
        one.close()
