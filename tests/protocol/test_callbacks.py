"""Functions of users that would not run when called: refused by all that take functions."""

import logging
from collections.abc import AsyncIterator, Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock, Mock

import pytest

import libmodbus_py
from libmodbus_py import AsyncClient, Client, Device, Gateway, Hook, Mapping, Route, Server, pdu
from libmodbus_py.device.authorization import Authorization
from libmodbus_py.listen import Separator
from libmodbus_py.protocol.checks import checked_callback, finished, log_failure
from libmodbus_py.scan import scan, search
from libmodbus_py.services.fleet.outputs.writer import OutputWriter
from libmodbus_py.tools.listener.listener import logger as listeners
from tests.services.fleet.fleets import simulated_run
from tests.support.cases import each_case
from tests.support.outputs import FakeOutput, reading, write_readings

URL = "tcp://127.0.0.1:1"


async def waits(*_: object) -> bool:
    return True


async def yields_and_waits(*_: object) -> AsyncIterator[bool]:
    yield True


def yields(*_: object) -> Iterator[bool]:
    yield True


class Waiting:
    async def __call__(self, *_: object) -> bool:
        return True

    async def method(self, *_: object) -> bool:
        return True

    @classmethod
    async def of_class(cls, *_: object) -> bool:
        return True

    @staticmethod
    async def static(*_: object) -> bool:
        return True


DELAYED: list[Any] = [
    waits, yields_and_waits, yields, Waiting(), Waiting().method, Waiting.of_class, Waiting.static,
    partial(waits, 1), partial(partial(Waiting(), 1), 2), partial(Waiting().method), AsyncMock(),
]  # fmt: skip


def device(**hooks: Any) -> Device:
    return Device(Mapping(holding_registers=10), **hooks)


def registered(**rules: Any) -> None:
    pdu.register(type("Own", (pdu.RawRequest,), {"function": 0x6D, **rules}))


TAKING: dict[str, Callable[[Any], object]] = {
    **{
        name: partial(lambda name, call: device(**{name: call}), name)
        for name in ("before_write", "after_write", "before_read", "authorize", "canopen")
    },
    "handlers": lambda call: device(handlers={pdu.ReadHoldingRegisters: call}),
    "Hook": Hook,
    "Authorization": Authorization,
    "server trace": lambda call: Server(device(), trace=call),
    "server audit": lambda call: Server(device(), audit=call),
    "gateway audit": lambda call: Gateway([Route(URL)], audit=call),
    "server tracing": lambda call: Server(device()).tracing(call),
    "on_listening": lambda call: Server(device()).serve_forever(URL, on_listening=call),
    "on_hangup": lambda call: Server(device()).serve_forever(URL, on_hangup=call),
    "gateway authorize": lambda call: Gateway([Route(URL)], authorize=call),
    "gateway trace": lambda call: Gateway([Route(URL)], trace=call),
    "may_send": lambda call: AsyncClient(URL, may_send=call),
    "AsyncClient trace": lambda call: AsyncClient(URL, trace=call),
    "AsyncClient on_state": lambda call: AsyncClient(URL, on_state=call),
    "Client trace": lambda call: Client(URL, trace=call),
    "Client on_state": lambda call: Client(URL, on_state=call),
    "scan": lambda call: scan(URL, on_progress=call),
    "search": lambda call: search(URL, on_progress=call),
    "Separator": lambda call: Separator("rtu", call),
    "request_length": lambda call: registered(request_length=staticmethod(call)),
    "response_length": lambda call: registered(response_length=staticmethod(call)),
}


@pytest.mark.parametrize("name", TAKING)
@each_case("call", DELAYED)
def test_delayed_functions_are_refused(name: str, call: Any) -> None:
    with pytest.raises(TypeError, match="must be a plain function"):
        TAKING[name](call)


@pytest.mark.parametrize("name", TAKING)
@each_case("call", [7, "print", {}])
def test_values_that_are_no_function_are_refused(name: str, call: Any) -> None:
    with pytest.raises(TypeError, match="must be a function"):
        TAKING[name](call)


class Plain:
    def __call__(self, *_: object) -> bool:
        return True


@each_case("call", [print, Plain(), Plain, partial(print, 1), Mock(), lambda: waits(), str.upper])
def test_callables_that_return_no_coroutine_are_accepted(call: Any) -> None:
    assert checked_callback("call", call) is call


def hidden(*_: object) -> Any:
    """Return a coroutine, as ``lambda access: waits(access)`` does."""
    return waits()


WRITE = pdu.WriteRegister(3, 77).encode()


@pytest.mark.parametrize("name", ["before_write", "after_write", "authorize"])
def test_a_hook_that_returns_a_coroutine_is_a_failure(name, caplog) -> None:
    device_ = device(**{name: hidden})
    assert device_.answer(WRITE) == b"\x86\x04"
    assert "which nothing awaits" in caplog.text
    if name != "after_write":
        assert device_.mapping.holding_registers[3] == 0


def test_a_handler_that_returns_a_coroutine_is_a_failure() -> None:
    assert device(handlers={pdu.WriteRegister: hidden}).answer(WRITE) == b"\x86\x04"


def test_a_result_that_already_runs_is_accepted() -> None:
    task: Any = object()
    assert finished("after_write", task) is task
    assert finished("after_write", [1]) == [1]


@each_case("make", [waits, yields, yields_and_waits])
def test_a_coroutine_that_was_never_started_is_refused(make: Callable[[], object]) -> None:
    with pytest.raises(TypeError, match="hook returned"):
        finished("hook", make())


def test_a_log_that_fails_is_reported_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    class Broken(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            raise OSError("disk full")

    logger, handler = logging.getLogger("libmodbus_py.broken"), Broken()
    logger.addHandler(handler)
    try:
        raise ZeroDivisionError
    except ZeroDivisionError:
        log_failure(logger.name, "%s failed", "it")
    finally:
        logger.removeHandler(handler)
    message = capsys.readouterr().err
    assert "disk full" in message
    assert "ZeroDivisionError" in message


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


def test_every_logger_of_the_package_is_protected() -> None:
    folder = Path(libmodbus_py.__file__).parent
    with_plain = {
        str(path.relative_to(folder))
        for path in folder.rglob("*.py")
        if "getLogger(" in path.read_text()
    }
    assert with_plain == PLAIN


@pytest.mark.usefixtures("failing")
def test_an_output_continues_after_a_reported_failure(capsys: pytest.CaptureFixture[str]) -> None:
    output = FakeOutput(refused=("b",))
    writer: OutputWriter = simulated_run(
        write_readings(output, [reading(device, "one") for device in "abc"])
    )
    assert (writer.statistics.written, writer.statistics.dropped) == (2, 1)
    assert "the disk is full" in capsys.readouterr().err


def test_a_message_names_the_line_that_logs(caplog: pytest.LogCaptureFixture) -> None:
    listeners.warning("here")
    (record,) = caplog.records
    assert record.filename == "test_callbacks.py"
