"""
Loggers whose handlers fail: nothing of the package ends for it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

import libmodbus_py
from libmodbus_py.services.fleet.outputs.pump import Pump
from libmodbus_py.tools.listener.listener import logger as listeners
from tests.services.fleet.fleets import simulated_run
from tests.services.fleet.outputs.test_unwritable_readings import Picky, pumped, reading

PACKAGE = "libmodbus_py"

# The logger itself, two that only receive handlers, and frames, which `Trace` logs guarded.
PLAIN = {"protocol/logs.py", "cli/logs.py", "cli/tracing.py", "ports/trace.py"}


class Failing(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        raise OSError("the disk is full")


@pytest.fixture
def failing() -> Iterator[None]:
    handler = Failing()
    logging.getLogger(PACKAGE).addHandler(handler)
    yield
    logging.getLogger(PACKAGE).removeHandler(handler)


def test_every_logger_of_a_module_is_harmless() -> None:
    folder = Path(libmodbus_py.__file__).parent
    with_plain = {
        str(path.relative_to(folder))
        for path in folder.rglob("*.py")
        if "getLogger(" in path.read_text()
    }
    assert with_plain == PLAIN


@pytest.mark.usefixtures("failing")
def test_an_output_that_reports_a_failure_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    output = Picky(refused=("b",))
    pump: Pump = simulated_run(pumped(output, [reading(device, "one") for device in "abc"]))
    assert (pump.statistics.written, pump.statistics.dropped) == (2, 1)
    assert "the disk is full" in capsys.readouterr().err


def test_a_message_names_the_line_that_logs(caplog: pytest.LogCaptureFixture) -> None:
    listeners.warning("here")
    (record,) = caplog.records
    assert record.filename == "test_logs.py"
