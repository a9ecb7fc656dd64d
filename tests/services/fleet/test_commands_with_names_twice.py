"""
Commands in JSON whose objects have a name twice: refused, because either value could be meant.
"""

from __future__ import annotations

import pytest

from libmodbus_py.services.fleet.commands import wanted_of
from tests.support.cases import each_case


@each_case(
    "data",
    [
        b'{"value": 1, "value": 2}',
        b'{"value": 1, "id": 1, "id": 2}',
        b'{"value": {"door": 1, "door": 0}}',
        b'[{"a": 1, "a": 1}]',
        b'{"value": 1, "v\\u0061lue": 2}',
    ],
)
def test_a_name_that_occurs_twice_is_refused(data: bytes) -> None:
    problem = wanted_of(data).problem
    assert problem.endswith(": occurs twice in its JSON")


@pytest.mark.parametrize("data", [b'{"value": {"door": 1, "mode": 1}, "id": 1}'])
def test_names_that_occur_once_are_taken(data: bytes) -> None:
    wanted = wanted_of(data)
    assert (wanted.problem, wanted.value, wanted.id) == ("", {"door": 1, "mode": 1}, 1)
