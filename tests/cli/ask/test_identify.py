"""
The command identify.
"""

from __future__ import annotations

import json

from tests.support.commands import run


def test_identify(url: str) -> None:
    done = run("identify", url)
    assert done.code == 0
    assert "VendorName          libmodbus-py\n" in done.out
    assert "running             True\n" in done.out
    found = json.loads(run("identify", url, "--level", "0", "--json").out)
    assert found["VendorName"] == "libmodbus-py"
    assert "ProductCode" not in found
    assert run("identify", url, "--level", "all").code == 2
