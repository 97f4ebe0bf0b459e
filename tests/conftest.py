"""What every test shares."""

import os

import pytest
from hypothesis import settings

# no deadline: the first call compiles; derandomized: a failure in one place is one everywhere
settings.register_profile("seatrial", deadline=None, derandomize=True)
settings.load_profile("seatrial")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what is marked `data` where there are no outside data."""
    if os.environ.get("SEATRIAL_DATA"):
        return
    for item in items:
        if item.get_closest_marker("data"):
            item.add_marker(
                pytest.mark.skip(reason="needs outside data: SEATRIAL_DATA=FOLDER make test-data")
            )
