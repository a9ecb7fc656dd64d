"""
Where the records of a TLS connection end (RFC 8446, 5.1).
"""

import random

import pytest

from libmodbus_py.security.tunnel import Records


def record(size: int, kind: int = 23) -> bytes:
    return bytes([kind, 3, 3]) + size.to_bytes(2, "big") + bytes(size)


def is_midway(stream: bytes) -> bool:
    """Walk over all of a stream from its beginning."""
    while stream:
        size = 5 + int.from_bytes(stream[3:5], "big") if len(stream) >= 5 else 5
        if len(stream) < size:
            return True
        stream = stream[size:]
    return False


@pytest.mark.parametrize("size", [0, 1, 255, 256, 0x4100])
def test_one_whole_record_is_told(size: int) -> None:
    records = Records()
    assert records.follow(record(size))
    assert not records.is_midway
    assert records.follow(record(size))


@pytest.mark.parametrize(
    "data",
    [b"", record(3)[:4], record(3)[:5], record(3)[:-1], record(3) + b"\x17", record(3) + record(4)],
    ids=["nothing", "half a header", "a header", "a byte less", "a byte more", "two records"],
)
def test_anything_else_is_not_taken_for_one_record(data: bytes) -> None:
    records = Records()
    assert not records.follow(data)
    assert records.is_midway == is_midway(data)


def test_what_looks_like_a_record_within_another_one_is_none() -> None:
    records = Records()
    records.follow(record(40)[:10])
    assert not records.follow(record(3))
    assert records.is_midway


@pytest.mark.parametrize("seed", range(20))
def test_it_is_known_after_each_piece(seed: int) -> None:
    chance = random.Random(seed)
    sizes = [chance.choice([0, 1, 2, 5, 9, 260, 700]) for _ in range(60)]
    stream = b"".join(map(record, sizes))
    records, at = Records(), 0
    while at < len(stream):
        size = chance.choice([1, 2, 3, 4, 5, 6, 7, 14, 300, 1000])
        records.follow(stream[at : at + size])
        at += size
        assert records.is_midway == is_midway(stream[:at]), at
