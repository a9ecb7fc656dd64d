"""Lines that return each request (local echo), at a client: an echo is never a value."""

import logging
from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, InvalidResponse, ModbusError, ModbusTimeoutError, pdu
from tests.support.cases import each_case
from tests.support.clients import World, read
from tests.support.driver import ASCII, LINE, Driver, ascii_frame, kinds, rtu, value
from tests.support.peers import OnRequest, Write, answer
from tests.support.replies import exchange

# A request that is a possible answer: 3 bytes of coils.
COILS = pdu.ReadCoils(0x0311, 24)
WRITE = pdu.WriteRegister(1, 2)
# The same length as an answer: 10 bytes of registers.
BOTH = pdu.ReadWriteRegisters(0x0A00, 5, 1, (7,))

SCHEMES = ["rtu+tcp", "rtu+udp", "ascii+tcp", "rtu", "ascii"]
STRAYS = [b"", b"\x00", b"\xff\x00"]


def returning(scheme: str, *, stray: bytes = b"", answers: bool = True) -> OnRequest:
    """Return what comes, behind stray bytes, and then answer reads of one register."""

    def on_request(request: bytes, write: Write) -> None:
        write(stray + request)
        if answers:
            write(answer(request, scheme), after=0.01)

    return on_request


def rtu_of(request: pdu.Request[Any]) -> bytes:
    return rtu((b"\x01" + request.encode()).hex())


def confirmed_by_itself(driver: Driver) -> None:
    """Check that a write is confirmed by the frame of its request."""
    batch = driver.ask(WRITE)
    driver.come(driver.sent[-1])
    assert batch.outcomes == [None]


def taken_for_a_value(driver: Driver) -> None:
    """Check that an answer equal to its request is the result."""
    batch = driver.ask(COILS)
    driver.come(driver.sent[-1])
    assert len(batch.outcomes[0]) == 24


def with_setting(url: str, setting: str) -> str:
    return f"{url}{'&' if '?' in url else '?'}{setting}" if setting else url


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("stray", STRAYS[:2])
def test_an_echo_is_logged_once_and_changes_no_read(world: World, scheme, stray, caplog) -> None:
    with world.client_of(scheme, returning(scheme, stray=stray), timeout=1) as client:
        assert [read(client, address) for address in range(30)] == list(range(30))
        assert client.statistics.echoes == 1
        assert client.statistics.late_answers == 0
    messages = [item.getMessage() for item in caplog.records if item.levelno == logging.WARNING]
    assert len(messages) == 1
    assert "local echo" in messages[0]
    assert "echo=1" in messages[0]


@pytest.mark.parametrize("setting", ["", "echo=1"])
def test_no_echo_is_the_value_of_a_read(world: World, setting: str) -> None:
    """Only the echo comes, of a request that is a possible answer."""
    peer = world.peer("rtu", returning("rtu", answers=False))
    with world.connect(with_setting(peer.url, setting), timeout=0.1) as client:
        for request in (COILS, COILS, BOTH, COILS):
            with pytest.raises(ModbusError):
                client.execute(request)


def test_the_first_answer_that_is_equal_to_its_request_is_invalid() -> None:
    for request in (COILS, BOTH):
        driver = Driver(LINE, timeout=1)
        batch = driver.ask(request)
        driver.come(rtu_of(request))
        assert not batch.is_done
        driver.wait(1)
        assert kinds(batch) == [InvalidResponse]
        assert "echo=True or False" in str(batch.outcomes[0])


def test_a_value_equal_to_its_request_is_accepted_where_there_is_no_echo() -> None:
    driver = Driver(LINE, timeout=1)
    exchange(driver, 1)
    taken_for_a_value(driver)


SEVERAL = [
    (pdu.WriteCoils(7, (True,)), "01 0F 0007 0001", None),
    (pdu.WriteRegisters(7, (9,)), "01 10 0007 0001", None),
]
TELLING = [
    (pdu.ReadInputRegisters(7, 1), "01 04 02 0009", [9]),
    (pdu.ReadWriteRegisters(7, 1, 7, (9,)), "01 17 02 0009", [9]),
]


@each_case(("request_", "body", "result"), TELLING)
@each_case("url", [LINE, ASCII])
def test_a_return_that_cannot_be_the_answer_shows_an_echo(request_, body, result, url) -> None:
    driver = Driver(url, timeout=1)
    batch = driver.ask(request_)
    driver.come(driver.sent[-1])
    driver.wait(0.1)
    assert not batch.is_done
    assert driver.statistics.echoes == 1
    driver.come(rtu(body) if url == LINE else ascii_frame(body))
    assert batch.outcomes == [result]


@each_case(("request_", "body", "result"), SEVERAL)
@each_case("url", [LINE, ASCII])
def test_a_returned_write_of_several_cells_shows_no_echo(request_, body, result, url):
    """Some devices answer functions 15 and 16 with the whole request."""
    make = rtu if url == LINE else ascii_frame
    driver = Driver(url, timeout=1)
    batch = driver.ask(request_)
    driver.come(driver.sent[-1])
    driver.wait(0.1)
    assert not batch.is_done
    driver.come(make(body))
    driver.wait(0.05)  # the end of the request may be the beginning of another frame
    assert batch.outcomes == [result]
    driver.ask(request_)
    driver.come(driver.sent[-1])
    driver.wait(1)
    batch = driver.ask(WRITE)
    driver.come(make("01 06 0001 0002"))
    assert batch.outcomes == [None]
    assert driver.statistics.echoes == 0


@each_case("request_", [WRITE, pdu.WriteCoil(1, True), pdu.Diagnostics(0, b"\1\2")])
def test_a_returned_frame_that_may_be_the_answer_does_not_show_an_echo(request_: Any) -> None:
    driver = Driver(LINE, timeout=1)
    for _ in range(2):
        batch = driver.ask(request_)
        driver.come(driver.sent[-1])
        driver.wait(0.1)
        assert batch.is_done
        assert not isinstance(batch.outcomes[0], Exception)
    assert driver.statistics.echoes == 0


@each_case("url", [LINE, "rtu+tcp://192.0.2.1", ASCII])
def test_an_echo_is_found_after_requests_without_any_received_byte(url: str) -> None:
    """The converter had no power, or the line was open."""
    make = ascii_frame if url == ASCII else rtu
    driver = Driver(url, timeout=1)
    for number in (1, 2):
        driver.ask(number)
        driver.wait(2)
    batch = driver.ask(3)
    driver.come(driver.sent[-1] + make("01 03 02 0003"))
    driver.wait(0.5)
    assert batch.outcomes == [[3]]
    assert driver.statistics.echoes == 1


def test_a_returned_read_is_no_answer_where_there_is_no_echo() -> None:
    """Once; and it shows no time in which the unit answers."""
    driver = Driver(LINE, timeout=1)
    exchange(driver, 1, after=0.1)
    batch = driver.ask(2)
    driver.come(driver.sent[-1])
    driver.wait(0.05)
    assert not batch.is_done
    driver.wait(0.05)
    driver.come(value(2))
    assert batch.outcomes == [[2]]


def echoing(url: str = LINE) -> Driver:
    """Return a driver that knows of an echo, from a read."""
    driver = Driver(url, timeout=1)
    driver.ask(5)
    driver.come(driver.sent[-1] + value(5))
    assert driver.statistics.echoes == 1
    return driver


def test_an_echo_that_ends_is_noticed() -> None:
    driver = echoing()
    for number in range(5):
        exchange(driver, number)
    confirmed_by_itself(driver)


def test_a_new_connection_may_have_no_echo() -> None:
    driver = echoing("rtu+tcp://192.0.2.1")
    driver.reconnect()
    confirmed_by_itself(driver)


def test_the_first_half_of_an_echo_is_not_joined_to_bytes_of_a_new_connection() -> None:
    driver = echoing("rtu+tcp://192.0.2.1")
    driver.ask(6)
    driver.come(driver.sent[-1][:5])
    driver.reconnect()
    batch = driver.ask(7)
    driver.wait_for(3)  # until the answer that the unit owes would be over
    driver.come(value(7)[:4])
    driver.wait(0.1)
    driver.come(value(7)[4:])
    driver.wait(0.2)
    assert batch.outcomes == [[7]]


def known(is_set: bool) -> Driver:
    return Driver(f"{LINE}&echo=1", timeout=1) if is_set else echoing()


@each_case("stray", STRAYS)
@each_case("is_set", [False, True])
def test_the_echo_of_a_write_does_not_confirm_it(stray: bytes, is_set: bool) -> None:
    """With `echo=1` this holds from the first frame: the unit may be dead, or refuse the write."""
    driver = known(is_set)
    batch = driver.ask(WRITE)
    driver.come(stray + driver.sent[-1])
    driver.wait(0.01)
    assert not batch.is_done
    driver.come(rtu("01 86 02"))
    driver.wait(0.1)
    assert kinds(batch) == [IllegalDataAddress]
    batch = driver.ask(WRITE)
    driver.come(stray + driver.sent[-1])
    driver.wait(1)
    assert isinstance(batch.outcomes[0], ModbusTimeoutError)


@each_case("stray", STRAYS)
@each_case("pause", [None, 0.01])
@each_case("is_set", [False, True])
def test_a_write_is_confirmed_by_the_frame_after_its_echo(stray, pause, is_set) -> None:
    driver = known(is_set)
    for _ in range(2):
        batch = driver.ask(WRITE)
        echo = stray + driver.sent[-1]
        if pause is None:
            driver.come(echo + driver.sent[-1])
        else:
            driver.come(echo)
            driver.wait(pause)
            assert not batch.is_done
            driver.come(driver.sent[-1])
        driver.wait(0.1)
        assert batch.outcomes == [None]
    assert driver.statistics.late_answers == 0
    assert driver.is_at_rest


@each_case("is_set", [False, True])
def test_an_echo_in_pieces_is_recognised(is_set: bool) -> None:
    driver = known(is_set)
    for number in range(5):
        batch = driver.ask(number)
        data = driver.sent[-1] + value(number)
        for at in range(len(data)):
            driver.come(data[at : at + 1])
            driver.wait(0.001)
        assert batch.outcomes == [[number]]


@each_case("is_set", [False, True])
def test_an_answer_is_found_after_an_echo_that_is_itself_a_possible_answer(is_set: bool) -> None:
    driver = known(is_set)
    bits = [True] + [False] * 23
    for _ in range(2):
        batch = driver.ask(COILS)
        driver.come(driver.sent[-1], rtu("01 01 03 010000"))
        assert batch.outcomes == [bits]


def test_an_echo_after_much_noise_does_not_confirm_a_write() -> None:
    driver = Driver(f"{LINE}&echo=1", timeout=1)
    for noise in (b"\xff" * 9, b"\xff" * 300):
        batch = driver.ask(WRITE)
        driver.come(noise + driver.sent[-1])
        driver.wait(0.1)
        assert not batch.is_done
        driver.come(rtu("01 86 02"))
        driver.wait(0.1)
        assert kinds(batch) == [IllegalDataAddress]


@pytest.mark.parametrize("scheme", ["rtu", "ascii", "rtu+tcp"])
def test_with_the_option_echo_no_echo_is_searched_for(world: World, scheme: str) -> None:
    def writes_too(request: bytes, write: Write) -> None:
        is_write = (request[3:5] == b"06") if scheme == "ascii" else request[1] == 6
        write(request)
        write(request if is_write else answer(request, scheme), after=0.01)

    peer = world.peer(scheme, writes_too)
    with world.connect(with_setting(peer.url, "echo=1"), timeout=1) as client:
        client.write_register(1, 2)  # right from the first frame
        assert [read(client, address) for address in range(9)] == list(range(9))
        assert client.statistics.late_answers == 0
        assert client.statistics.timeouts == 0


def test_with_echo_set_to_0_a_returned_write_is_its_answer() -> None:
    driver = Driver(f"{LINE}&echo=0", timeout=1)
    for number in (1, 2):
        batch = driver.ask(number)
        driver.come(driver.sent[-1], value(number))
        driver.wait(0.1)
        assert batch.outcomes == [[number]]  # the returned frame is noise
    confirmed_by_itself(driver)
    taken_for_a_value(driver)
    assert driver.statistics.echoes == 0
