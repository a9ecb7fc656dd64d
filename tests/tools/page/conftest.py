"""Pages whose streams and sweeps are not waited for."""

import pytest

SHORT = 0.01


@pytest.fixture(autouse=True)
def short_periods(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the seconds between two looks at what changed, but not below a browser."""
    if not request.path.name.endswith("_in_browser.py"):
        monkeypatch.setattr("libmodbus_py.tools.page.streams.PERIOD", SHORT)
        monkeypatch.setattr("libmodbus_py.tools.timed_server.SWEEP", SHORT)
