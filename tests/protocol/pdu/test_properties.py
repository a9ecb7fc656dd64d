"""Any request and any result survive the wire; tests/test_fuzz.py shows the same of any bytes."""

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import pdu
from libmodbus_py.protocol.pdu.interface import LAST_OBJECT, pages
from tests.protocol.pdu.examples import FROM_FIELDS, tells_its_length
from tests.protocol.pdu.test_identification import served

registers = st.integers(0, 65535)


def at(count: int) -> st.SearchStrategy[int]:
    """An address from which `count` items fit."""
    return st.integers(0, 65536 - count)


@st.composite
def requests(draw: st.DrawFn) -> pdu.Request[Any]:
    function = draw(st.sampled_from(sorted(FROM_FIELDS)))
    if function in (1, 2, 3, 4):
        count = draw(st.integers(1, 2000 if function < 3 else 125))
        return pdu.REQUESTS[function](draw(at(count)), count)  # type: ignore[call-arg]
    if function == 5:
        return pdu.WriteCoil(draw(registers), draw(st.booleans()))
    if function == 6:
        return pdu.WriteRegister(draw(registers), draw(registers))
    if function == 15:
        bits = draw(st.lists(st.booleans(), min_size=1, max_size=1968))
        return pdu.WriteCoils(draw(at(len(bits))), bits)
    if function == 16:
        values = draw(st.lists(registers, min_size=1, max_size=123))
        return pdu.WriteRegisters(draw(at(len(values))), values)
    if function == 20:
        lengths = draw(st.lists(st.integers(1, 5), min_size=1, max_size=20))
        return pdu.ReadFileRecords(
            [(draw(st.integers(1, 65535)), draw(st.integers(0, 9995)), n) for n in lengths]
        )
    if function == 21:
        pieces = draw(
            st.lists(st.lists(registers, min_size=1, max_size=5), min_size=1, max_size=14)
        )
        return pdu.WriteFileRecords(
            [(draw(st.integers(1, 65535)), draw(st.integers(0, 9995)), v) for v in pieces]
        )
    if function == 22:
        return pdu.MaskWriteRegister(draw(registers), draw(registers), draw(registers))
    if function in (7, 11, 12, 17):
        return pdu.REQUESTS[function]()
    if function == 8:
        sub_function = draw(registers | st.integers(0, 21))
        return pdu.Diagnostics(sub_function, bytes(draw(word_bytes(1 if sub_function else 125))))
    if function == 24:
        return pdu.ReadFifoQueue(draw(registers))
    if function == 43 and draw(st.booleans()):
        return pdu.EncapsulatedTransport(13, draw(st.binary(max_size=251)))
    if function == 43:
        return pdu.ReadDeviceIdentification(draw(st.integers(1, 4)), draw(st.integers(0, 255)))
    values = draw(st.lists(registers, min_size=1, max_size=121))
    count = draw(st.integers(1, 125))
    return pdu.ReadWriteRegisters(draw(at(count)), count, draw(at(len(values))), values)


def word_bytes(most: int) -> st.SearchStrategy[bytes]:
    return st.binary(min_size=2, max_size=2 * most).map(lambda data: data[len(data) % 2 :])


identifications = st.dictionaries(st.integers(0, 255), st.binary(max_size=244), max_size=12).map(
    lambda objects: dict(sorted(objects.items()))
)


def one_page(objects: dict[int, bytes]) -> dict[int, bytes]:
    """The first of the objects, as many as fit."""
    return pages(pdu.ReadDeviceIdentification(3), objects).objects


def results(request: pdu.Request[Any]) -> st.SearchStrategy[Any]:
    def exactly(item: st.SearchStrategy[Any], count: int) -> st.SearchStrategy[list[Any]]:
        return st.lists(item, min_size=count, max_size=count)

    match request:
        case pdu.ReadCoils() | pdu.ReadDiscreteInputs():
            return st.binary(min_size=1, max_size=1).map(
                lambda pattern: [bool(pattern[0] >> at % 8 & 1) for at in range(request.count)]
            )
        case pdu.ReadHoldingRegisters() | pdu.ReadInputRegisters():
            return exactly(registers, request.count)
        case pdu.ReadWriteRegisters():
            return exactly(registers, request.read_count)
        case pdu.ReadFileRecords():
            return st.tuples(*(exactly(registers, n) for _, _, n in request.records)).map(list)
        case pdu.ReadExceptionStatus():
            return st.integers(0, 255)
        case pdu.Diagnostics():
            return st.binary(min_size=len(request.data), max_size=len(request.data))
        case pdu.ReadCommEventCounter():
            return st.builds(pdu.CommEventCounter, registers, registers)
        case pdu.ReadCommEventLog():
            events = st.binary(max_size=64)
            return st.builds(pdu.CommEventLog, registers, registers, registers, events)
        case pdu.ReportServerId():
            byte = st.binary(min_size=1, max_size=1)
            return st.builds(pdu.ServerId, byte, st.booleans(), st.binary(max_size=249))
        case pdu.ReadFifoQueue():
            return st.lists(registers, max_size=31)
        case pdu.ReadDeviceIdentification(code, object_id):
            byte = st.integers(0, 255)
            alone = st.binary(max_size=244).map(lambda value: {object_id: value})
            page = alone if code == 4 else identifications.map(one_page)
            return st.builds(pdu.IdentificationPage, byte, st.none() | byte, page, st.just(True))
        case pdu.EncapsulatedTransport():
            return st.binary(max_size=251)
        case _:
            return st.none()


class TestProperties:
    @settings(max_examples=60)
    @given(requests())
    def test_requests_decode_to_what_was_encoded(self, request_: pdu.Request[Any]) -> None:
        data = request_.encode()
        assert pdu.decode_request(data) == request_
        assert len(data) <= pdu.MAX_PDU
        right = len(data) if tells_its_length(data) else 0
        assert pdu.request_length(data) == right

    @settings(max_examples=60)
    @given(st.data())
    def test_results_decode_to_what_was_encoded(self, data: st.DataObject) -> None:
        request = data.draw(requests())
        result = data.draw(results(request))
        response = request.encode_response(result)
        assert request.decode_response(response) == result
        assert len(response) <= pdu.MAX_PDU
        right = len(response) if tells_its_length(response) else 0
        assert pdu.response_length(response) == right

    @settings(max_examples=30)
    @given(identifications, st.sampled_from(["basic", "regular", "extended"]))
    def test_any_identification_is_read_as_it_was(self, objects: dict[int, bytes], level: str):
        last = LAST_OBJECT[pdu.interface.LEVELS[level]]
        values = {number: value for number, value in objects.items() if number <= last}
        assert served(objects, level)[0] == values
