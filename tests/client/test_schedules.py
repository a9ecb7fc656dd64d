"""Whatever happens to a connection: no wrong value, no endless wait, no lost slot."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import ModbusError, pdu
from libmodbus_py.client.call import NOT_ASKED, Batch
from tests.support.driver import LINE, TCP, Driver, tcp, value
from tests.support.replies import answer, refusal

ASKING = ["ask", "ask", "many", "cancel", "broadcast"]


COMING = ["answer", "answer", "late", "refuse", "busy", "noise", "foreign", "half"]


PASSING = ["wait", "wait", "long wait", "lose"]


EVENTS = st.lists(
    st.tuples(st.sampled_from([*ASKING, *COMING, *PASSING]), st.integers(0, 255)), max_size=60
)


@pytest.mark.parametrize("url", [TCP, TCP.replace("tcp", "udp"), LINE, "rtu+tcp://192.0.2.1"])
@given(events=EVENTS, retries=st.integers(0, 2), spacing=st.sampled_from([0.0, 0.05]))
@settings(max_examples=150)
def test_no_schedule_gives_a_wrong_value_blocks_a_caller_or_leaks_a_slot(
    url: str, events: list[tuple[str, int]], retries: int, spacing: float
) -> None:
    """On a line no answer comes later than two timeouts after its request."""
    driver = Driver(url, timeout=1, retries=retries, busy_retries=1, request_spacing=spacing)
    batches: list[tuple[Batch, list[int]]] = []
    number = 0
    for event, choice in events:
        if event in ("ask", "many"):
            count = 1 if event == "ask" else choice % 5
            numbers = list(range(number, number + count))
            number += count
            batch = driver.ask(
                *numbers, unit=choice % 2 + 1, one_by_one=choice % 2 == 0, go_on=choice > 127
            )
            batches.append((batch, numbers))
        elif event == "cancel" and batches:
            driver.cancel(batches[choice % len(batches)][0])
        elif event == "broadcast":
            if "rtu" in url:
                driver.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
        elif event == "lose":
            driver.reconnect()
        elif event.endswith("wait"):
            driver.wait(choice / 100 if event == "wait" else 4)
        elif driver.sent:
            happen(driver, event, choice)
        if driver.connection.broken is not None:
            driver.replace_broken()
    settle_down(driver)
    for batch, numbers in batches:
        assert batch.is_done
        for value_, outcome in zip(numbers, batch.outcomes, strict=True):
            is_none = outcome is NOT_ASKED or isinstance(outcome, ModbusError)
            assert is_none or outcome == [value_]
    assert driver.is_at_rest
    driver.life.prove()  # who has lost three connections in a row may be refused
    count = len(driver.sent)
    last = driver.ask(77, unit=3, timeout=10)
    if driver.connection.broken is not None:
        driver.replace_broken()
    driver.wait_for(count + 1)
    driver.come(answer(driver))
    driver.wait(1)
    assert last.outcomes == [[77]]


def happen(driver: Driver, event: str, choice: int) -> None:
    """Deliver bytes, complete or in pieces."""
    is_line = not driver.has_ids
    # On a line only the last request can be answered at the right time.
    at = -1 if is_line else -1 - choice % min(8, len(driver.sent))
    if is_line and driver.sent[-1][0] == 0:
        return
    data = {
        "answer": lambda: answer(driver, at),
        "late": lambda: answer(driver, at),
        "refuse": lambda: refusal(driver, 2, at),
        "busy": lambda: refusal(driver, 6, at),
        "noise": lambda: bytes([choice]) if is_line else tcp(driver.sent[at], protocol=7),
        "foreign": lambda: value(9, unit=9) if is_line else tcp(driver.sent[at], number=0xFFFF),
        "half": lambda: answer(driver, at)[: choice % 7 + 1],
    }[event]()
    cut = choice % len(data)
    pieces = [data] if driver.is_udp else [data[:cut], data[cut:]]
    pieces = [piece for piece in pieces if piece]  # a port never returns an empty piece
    if (
        is_line
        and event in ("answer", "late", "refuse", "busy")
        and driver.now - driver.times[-1] > 1.99
    ):
        return  # later than anybody can know
    driver.come(*pieces)


def settle_down(driver: Driver) -> None:
    """Nobody answers any more: every deadline passes, over as many connections as it takes."""
    for _ in range(2000):
        if driver.is_at_rest:
            return
        driver.wait(1)
        if driver.connection.broken is not None:
            driver.replace_broken()
    raise AssertionError("somebody waits for ever")
