"""
Chains of models, hostile ones included: what is found, and in how many requests.
"""

from __future__ import annotations

import pytest

from libmodbus_py.sunspec import SunSpecError
from libmodbus_py.tools.sunspec.chain import BASES, walk
from tests.support.sunspec import END, MARKER, chain, walked

COMMON = [1, 66, *([0] * 66)]


def test_a_chain_is_followed_to_the_end_model() -> None:
    done = walked(walk(BASES), chain(COMMON, [64999, 3, 7, 8, 9]))
    found = done.result
    assert [tuple(each) for each in found.headers] == [(1, 40002, 66), (64999, 40070, 3)]
    assert (found.base, found.end, found.notes) == (40000, 40075, [])
    assert done.requests == [(0, 2), (40000, 2), (40002, 2), (40070, 2), (40075, 2)]


@pytest.mark.parametrize("base", BASES)
def test_the_marker_is_sought_at_each_base(base: int) -> None:
    assert walked(walk(BASES), chain(COMMON), base).result.base == base


def test_a_base_that_holds_something_else_is_passed_by() -> None:
    cells = [*([0] * 40000), *chain(COMMON)]
    done = walked(walk(BASES), cells, 0)
    assert (done.result.base, done.requests[:2]) == (40000, [(0, 2), (40000, 2)])


def test_no_marker_anywhere_is_an_error_that_says_what_is_there() -> None:
    with pytest.raises(SunSpecError) as caught:
        walked(walk(BASES), [0] * 10, 0)
    told = str(caught.value)
    assert "address 0: no SunS there" in told
    assert "address 40000: " in told
    assert "address 50000: " in told


def test_a_chain_without_an_end_model_ends_where_registers_end() -> None:
    done = walked(walk(BASES), chain(COMMON, end=[]))
    assert [each.id for each in done.result.headers] == [1]
    assert done.result.end is None
    assert len(done.requests) == 4
    assert done.result.notes[0].startswith("the chain has no end model: address 40070: ")


def test_a_length_of_0_for_ever_ends_after_256_models() -> None:
    done = walked(walk(BASES), chain(*[[7, 0]] * 5000))
    assert len(done.result.headers) == 256
    assert len(done.requests) == 2 + 256
    assert done.result.notes == ["the chain has more than 256 models; the rest is left out"]


def test_zeros_are_no_models() -> None:
    done = walked(walk(BASES), chain(COMMON, end=[0] * 5000))
    assert [each.id for each in done.result.headers] == [1]
    assert len(done.requests) == 4
    assert done.result.notes == [
        "the chain has no end model: there is no model 0, as at address 40070"
    ]


def test_a_length_that_leads_beyond_the_table_ends_the_chain() -> None:
    done = walked(walk(BASES), chain(COMMON, [101, 65535]))
    assert [each.id for each in done.result.headers] == [1]
    assert done.result.notes == [
        "model 101 at address 40070 is left out: its length, 65535, leads beyond address 65535"
    ]


def test_a_chain_that_fills_the_table_ends_there() -> None:
    length = 65536 - 40004
    done = walked(walk(BASES), chain([101, length, *([0] * length)], end=[]))
    assert [each.length for each in done.result.headers] == [length]
    assert len(done.requests) == 3
    assert done.result.notes == ["the chain has no end model before address 65535"]


def test_the_end_model_may_have_any_length() -> None:
    done = walked(walk(BASES), [*MARKER, END[0], 500])
    assert (done.result.headers, done.result.end) == ([], 40002)
