"""
Examples of commands that ask a device, and how their URLs are quoted.
"""

from __future__ import annotations

from tests.support.cases import each_case
from tests.support.commands import run


@each_case("name", ["read", "write", "identify", "diagnose", "raw"])
def test_help_tells_of_urls_and_quotes_them(name: str) -> None:
    text = run(name, "--help").out
    examples = [line for line in text.splitlines() if line.startswith(f"  libmodbus-py {name} ")]
    assert len(examples) == 4
    assert '"tcp://192.0.2.10?unit=7&timeout=2"' in text
    for each in examples:
        assert "&" not in each.replace("'tcp://192.0.2.10?unit=7&timeout=0.5'", "").replace(
            "'rtu:///dev/ttyUSB0?baudrate=9600&unit=7'", ""
        )
