"""
What moves or is busy is computed again when it is looked at.
"""

from __future__ import annotations

import pytest

from libmodbus_py import Access, Device, IllegalDataAddress, Mapping, Server, ServerDeviceBusy
from libmodbus_py.page import live_page
from tests.tools.page.watching import Visitor


def test_what_moves_is_computed_when_it_is_looked_at() -> None:
    mapping = Mapping(holding_registers=8, input_registers=8)
    seen: list[Access] = []

    def compute(access: Access) -> None:
        if access.address <= 3 < access.address + access.count:
            raise IllegalDataAddress("clients may not read it")
        seen.append(access)
        if access.address == 4:
            mapping.input_registers[4] += 1

    with live_page(server := Server(Device(mapping, before_read=compute))) as page:
        visitor = Visitor(page.url)
        with visitor.watching():
            assert not seen
            visitor.look(None, "input_registers", 0, 8)
            visitor.receive(lambda: visitor.seen["cells"].get(4, 0) >= 3)
        count = len(seen)
        assert {each.table for each in seen} == {"input_registers"}
        assert server.statistics.requests == 0
    assert len(seen) <= count + 8  # nothing is computed when nobody looks


@pytest.mark.parametrize("error", [ZeroDivisionError, SystemExit])
def test_a_hook_that_fails_is_logged_once_and_the_page_goes_on(
    error: type[BaseException],
    caplog: pytest.LogCaptureFixture,
) -> None:
    def broken(access: Access) -> None:
        raise error

    mapping = Mapping(coils=8)
    with live_page(Server(Device(mapping, before_read=broken))) as page:
        visitor = Visitor(page.url)
        with visitor.watching():
            visitor.look(None, "coils", 0, 8)
            visitor.receive(lambda: visitor.seen["cells"])
            mapping.coils[3] = True
            visitor.receive(lambda: visitor.seen["cells"][3] == 1)
            assert len(caplog.records) == 1
            body = {"unit": None, "table": "coils", "address": 5, "text": "on"}
            assert visitor.post("/value", **body, type="", order="ABCD") == {}
            visitor.receive(lambda: visitor.seen["cells"][5] == 1)
    assert [each.getMessage() for each in caplog.records] == [
        "coils range(0, 8): before_read failed",
        "coils range(5, 6): before_read failed",
    ]


def test_what_was_busy_is_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("libmodbus_py.tools.page.refreshing.RETRY", 0.3)
    mapping, is_busy = Mapping(input_registers=8), True

    def compute(access: Access) -> None:
        if is_busy:
            raise ServerDeviceBusy
        mapping.input_registers[4] = 42

    with live_page(Server(Device(mapping, before_read=compute))) as page:
        visitor = Visitor(page.url)
        with visitor.watching():
            visitor.look(None, "input_registers", 0, 8)
            visitor.receive(lambda: visitor.seen["cells"])
            is_busy = False
            visitor.receive(lambda: visitor.seen["cells"][4] == 42)
