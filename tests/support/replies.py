"""What answers the requests of a `Driver`, whatever their framing."""

import pytest

from libmodbus_py import ModbusTimeoutError

from .driver import LINE, TCP, Driver, kinds, rtu, tcp, value

BOTH = pytest.mark.parametrize("url", [TCP, LINE])


def answer(driver: Driver, at: int = -1) -> bytes:
    """Answer a request of a single register with its address."""
    adu = driver.sent[at]
    if driver.has_ids:
        return tcp(adu)
    return value(int.from_bytes(adu[2:4], "big"), unit=adu[0])


def answer_all(driver: Driver) -> None:
    """Answer the last request, and what is sent then, until nothing is left."""
    while not driver.is_at_rest:
        driver.come(answer(driver))


def exchange(
    driver: Driver, address: int, result: int | None = None, unit: int = 1, after: float = 0.0
) -> None:
    """
    Ask for a register, and check that what is answered is the result at once. `result`: what is
    answered; by default the address; `after`: how many seconds the answer takes.
    """
    number = address if result is None else result
    batch = driver.ask(address, unit=unit)
    driver.wait(after)
    driver.come(reply(driver, f"03 02 {number:04X}"))
    assert batch.outcomes == [[number]]


def time_out(driver: Driver, address: int = 1, unit: int = 1) -> None:
    """Ask for a register, and check that the request fails when its time is over."""
    batch = driver.ask(address, unit=unit)
    driver.wait(driver.settings["timeout"])
    assert kinds(batch) == [ModbusTimeoutError]


def reply(driver: Driver, body: str, at: int = -1) -> bytes:
    """Answer a request with a PDU."""
    adu = driver.sent[at]
    return tcp(adu, body) if driver.has_ids else rtu(f"{adu[0]:02X} {body}")


def refusal(driver: Driver, code: int, at: int = -1) -> bytes:
    """Refuse a read of holding registers."""
    return reply(driver, f"83 {code:02X}", at)


def addresses(driver: Driver) -> list[int]:
    """Return the addresses of the requests, in their order."""
    first = 8 if driver.has_ids else 2
    return [int.from_bytes(frame[first : first + 2], "big") for frame in driver.sent]
