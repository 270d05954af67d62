"""What the tests of studies share."""

import pytest

from musebot.protocols.compare import benchmark


@pytest.fixture
def cheap_costs(monkeypatch):
    """Measures what learners cost with fewer robots and steps."""
    monkeypatch.setattr(benchmark, "TIMED", (2, 20))
