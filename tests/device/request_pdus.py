"""Any requests, good and bad, as hypothesis draws them."""

import struct

from hypothesis import strategies as st

from libmodbus_py import pdu
from tests.device.devices import BITS, REGISTERS, words
from tests.device.model import KNOWN

edges = st.sampled_from(
    sorted(
        {
            max(0, min(65535, edge + off))
            for addresses in (*BITS.values(), *REGISTERS.values())
            for edge in (addresses.start, addresses.stop)
            for off in (-2, -1, 0, 1)
        }
        | {0, 300, 65534, 65535}
    )
)
inside = st.integers(100, 399)
addresses = inside | edges
counts = st.integers(1, 20) | st.sampled_from([0, 1, 99, 100, 121, 122, 123, 124, 125, 126, 65535])
bit_counts = counts | st.sampled_from([1967, 1968, 1969, 1999, 2000, 2001])
word = st.integers(0, 65535)


def lied(body: bytes, at: int, draw: st.DrawFn) -> bytes:
    """Sometimes with another byte count at `at`, sometimes shorter or longer than it says."""
    match draw(st.integers(0, 11)):
        case 0:
            return body[:at] + bytes([draw(st.integers(0, 255))]) + body[at + 1 :]
        case 1:
            return body[: draw(st.integers(0, len(body)))]
        case 2:
            return body + draw(st.binary(min_size=1, max_size=3))
        case _:
            return body


@st.composite
def request_pdus(draw: st.DrawFn) -> bytes:
    code = draw(st.sampled_from(KNOWN))
    if code <= 4:
        body = words(draw(addresses), draw(bit_counts if code < 3 else counts))
    elif code == 5:
        body = words(draw(addresses), draw(st.sampled_from([0, 0xFF00, 0xFF00, 1, 0xFF])))
    elif code == 6:
        body = words(draw(addresses), draw(word))
    elif code == 15:
        count = draw(bit_counts)
        size = -(-count // 8) & 0xFF
        pattern = draw(st.binary(min_size=1, max_size=8))
        body = words(draw(addresses), count) + bytes([size]) + (pattern * 246)[: min(size, 246)]
    elif code == 16:
        values = draw(st.lists(word, max_size=6)) * draw(st.sampled_from([1, 1, 20]))
        values = values[:123]
        body = words(draw(addresses), len(values)) + bytes([2 * len(values)]) + words(*values)
    elif code == 20:
        subs = draw(st.lists(pieces(), min_size=0, max_size=4))
        body = b"".join(struct.pack(">BHHH", *sub) for sub in subs)
        body = bytes([len(body)]) + body
    elif code == 21:
        subs = draw(st.lists(pieces(8), min_size=0, max_size=4))
        body = b"".join(
            struct.pack(">BHHH", *sub) + (draw(st.binary(min_size=2, max_size=2)) * sub[3])
            for sub in subs
        )
        body = bytes([len(body)]) + body
    elif code == 22:
        body = words(draw(addresses), draw(word), draw(word))
    else:
        values = draw(st.lists(word, max_size=6)) * draw(st.sampled_from([1, 1, 20]))
        body = words(draw(addresses), draw(counts), draw(addresses), len(values))
        body += bytes([2 * len(values)]) + words(*values)
    count_at = {15: 4, 16: 4, 20: 0, 21: 0, 23: 8}.get(code, 1)
    return (bytes([code]) + lied(body, count_at, draw))[: pdu.MAX_PDU]


@st.composite
def pieces(draw: st.DrawFn, most: int = 125) -> tuple[int, int, int, int]:
    return (
        draw(st.sampled_from([6] * 9 + [5])),
        draw(st.sampled_from([3, 4, 4, 4, 65535, 0, 5])),
        draw(st.sampled_from([0, 1, 7, 9, 10, 11, 12, 9990, 9999, 10_000, 65535])),
        draw(st.sampled_from([1, 1, 2, 3, 0, min(most, 8), min(most, 121), most])),
    )
