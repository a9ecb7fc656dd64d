"""
The pytest plugin: fixtures with servers, and their transactions in the reports of failed tests.

Every run of pytest imports this file if the package is installed. So the file imports only pytest,
and each fixture imports the rest when a test uses it.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from ...server.faults import FaultSwitch
    from ..listener.transaction import Transaction
    from .recording import RecordingServer, ServerMaker
    from .wires import SerialWire

if not hasattr(pytest, "StashKey"):
    raise pytest.UsageError(
        f"the fixtures of libmodbus-py need pytest 7 or newer, not {pytest.__version__};"
        " use -p no:libmodbus_py to disable them"
    )

# The servers of a test, while it runs.
SERVERS = pytest.StashKey["list[RecordingServer]"]()

# The most transactions of each server that a report shows.
SHOWN = 50

# The most characters of a transaction, and the shortest duration, in seconds, that is shown.
WIDTH = 160
LATE = 0.05


@pytest.fixture
def make_modbus_server(request: pytest.FixtureRequest) -> Iterator[ServerMaker]:
    """Call it to start servers: make_modbus_server("rtu+tcp://127.0.0.1:0", devices=device)."""
    from .recording import ServerMaker

    with ServerMaker() as maker:
        request.node.stash[SERVERS] = maker.servers
        yield maker


@pytest.fixture
def modbus_server(make_modbus_server: ServerMaker) -> RecordingServer:
    """A running server on a free port, which answers every unit; all its tables are zero."""
    return make_modbus_server()


@pytest.fixture
def modbus_faults(modbus_server: RecordingServer) -> FaultSwitch:
    """Switch on faults of modbus_server: with modbus_faults.switch_on(Fault("no_answer")): ..."""
    return modbus_server.faults


@pytest.fixture
def modbus_serial_line(make_modbus_server: ServerMaker) -> Iterator[SerialWire]:
    """Two serial ports that are connected with each other; their paths are .client and .server."""
    from .wires import SerialWire

    with SerialWire() as line:
        yield line
        make_modbus_server.close()  # before the serial line is closed


# The other form, wrapper=True, needs a newer pluggy than pytest 7 requires.
@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, None]:
    report: pytest.TestReport = (yield).get_result()
    servers = item.stash.get(SERVERS, [])
    if servers and report.failed:
        report.sections.append(("modbus transactions", "\n".join(map(_report, servers))))
    if servers and report.when == "teardown":
        del item.stash[SERVERS]


def _report(server: RecordingServer) -> str:
    lines = [_line(transaction) for transaction in server.transactions]
    if not lines:
        return f"{server.url} none"
    left_out = [f"... {len(lines) - SHOWN} earlier ones"] * (len(lines) > SHOWN)
    return "\n".join([server.url, *left_out, *lines[-SHOWN:]])


def _line(transaction: Transaction) -> str:
    text, duration = str(transaction), transaction.duration or 0.0
    text = f"{text[:WIDTH]}..." if len(text) > WIDTH else text
    return f"{text} after {duration:.3f} s" if duration >= LATE else text
