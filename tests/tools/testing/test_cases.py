"""
The loop over a table of cases: one test that tries them all, and names those that failed.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.cases import each, each_case


def halves(table: Iterable[tuple[int, int]]) -> None:
    for check, (whole, half) in each(table):
        with check:
            assert whole // half == 2


def failure(table: Iterable[tuple[int, int]]) -> str:
    with pytest.raises(AssertionError) as caught:
        halves(table)
    return str(caught.value)


def test_a_table_without_failures_passes() -> None:
    halves([(4, 2), (6, 3)])


def test_every_failed_case_is_named_and_the_others_are_not() -> None:
    text = failure([(4, 2), (9, 3), (6, 3), (1, 0)])
    assert text.startswith("2 of 4 cases failed:\n  (9, 3)\n    test_cases.py:")
    assert "AssertionError: assert (9 // 3) == 2" in text
    assert "ZeroDivisionError: integer division" in text
    assert "(4, 2)" not in text
    assert "(6, 3)" not in text


def test_the_first_failure_is_the_cause() -> None:
    with pytest.raises(AssertionError) as caught:
        halves([(4, 2), (1, 0), (9, 3)])
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_many_failed_cases_are_all_named_but_not_all_explained() -> None:
    text = failure((n, 1) for n in range(3, 103))
    assert all(f"\n  ({n}, 1)" in text for n in range(3, 103))
    assert text.count("AssertionError") == 20


def test_a_missing_exception_fails_its_case() -> None:
    def never_raised() -> None:
        for check, _ in each("ab"):
            with check, pytest.raises(ValueError, match="bad"):
                pass

    with pytest.raises(AssertionError, match="2 of 2 cases failed"):
        never_raised()


def raising(error: BaseException) -> None:
    for check, _ in each([b"ab", b"cd"], name=lambda case: f"bytes {case!r}"):
        with check:
            raise error


def test_names_are_made_by_a_function() -> None:
    with pytest.raises(AssertionError, match=r"2 of 2 cases failed:\n  bytes b'ab'"):
        raising(OSError())


@pytest.mark.parametrize(
    "error",
    [
        pytest.skip.Exception("why"),
        KeyboardInterrupt(),
        pytest.fail.Exception("Timeout (>180.0s) from pytest-timeout."),
    ],
)
def test_what_ends_the_whole_test_leaves_the_loop(error: BaseException) -> None:
    with pytest.raises(type(error)) as caught:
        raising(error)
    assert caught.value is error


def test_an_empty_table_fails() -> None:
    assert failure([]) == "the table of cases is empty"


def test_a_check_that_is_not_used_fails() -> None:
    loop = each("ab")
    next(loop)
    with pytest.raises(AssertionError, match="was not used: 'a'"):
        next(loop)


def test_a_loop_that_is_left_early_does_not_hide_a_failure() -> None:
    loop = each("ab")
    check, _ = next(loop)
    with check:
        raise OSError
    with pytest.raises(AssertionError, match="a case had failed"):
        loop.close()


# --- the decorator ---------------------------------------------------------------------


def test_each_case_calls_the_test_with_every_combination() -> None:
    seen = []

    @each_case("text", ["a", "b"])
    @each_case(("low", "high"), [(1, 2), pytest.param(3, 4, id="more")])
    def test(fixture: str, text: str, low: int, high: int) -> None:
        seen.append((fixture, text, low, high))

    test(fixture="f")  # type: ignore[call-arg]
    assert seen == [("f", "a", 1, 2), ("f", "a", 3, 4), ("f", "b", 1, 2), ("f", "b", 3, 4)]
    assert list(inspect.signature(test).parameters) == ["fixture"]


def test_each_case_stands_before_each_test_of_a_class() -> None:
    @each_case("number", [1, 2])
    class Tests:
        helped: ClassVar[list[object]] = []

        def helper(self, number: int) -> None:
            self.helped.append(number)

        def test_one(self, number: int) -> None:
            self.helper(number)

        @each_case("text", "ab")
        def test_two(self, number: int, text: str) -> None:
            self.helped.append((number, text))

    Tests().test_one()  # type: ignore[call-arg]
    Tests().test_two()  # type: ignore[call-arg]
    assert Tests.helped == [1, 2, (1, "a"), (1, "b"), (2, "a"), (2, "b")]


def test_each_case_names_what_failed_by_its_arguments_or_ids() -> None:
    @each_case("half", [1, 2], ids=["one", "two"])
    @each_case(("text", "whole"), [("a", 2), ("b", 4)])
    def test(text: str, whole: int, half: int) -> None:
        assert whole // half == 2, text

    with pytest.raises(AssertionError) as caught:
        test()  # type: ignore[call-arg]
    lines = str(caught.value).splitlines()
    assert lines[0] == "2 of 4 cases failed:"
    assert lines[1] == "  one, text='b', whole=4"
    assert lines[2].startswith("    test_cases.py:")
    assert "  two, text='a', whole=2" in lines


def test_each_case_shows_the_example_that_hypothesis_found() -> None:
    @each_case("most", [3])
    @given(number=st.integers(0, 9))
    def test(most: int, number: int) -> None:
        assert number <= most

    with pytest.raises(AssertionError, match=r"1 of 1 cases failed:\n  most=3\n(.|\n)*number=4"):
        test()


def test_each_case_refuses_what_would_not_be_tried() -> None:
    def test(number: int) -> None: ...

    with pytest.raises(ValueError, match="marks"):
        each_case("number", [pytest.param(1, marks=pytest.mark.skip)])
    with pytest.raises(ValueError, match="no parameter other"):
        each_case("other", [1])(test)
    with pytest.raises(ValueError, match="zip"):
        each_case(("number", "other"), [(1,)])
    with pytest.raises(ValueError, match="2 cases have 1 ids"):
        each_case("number", [1, 2], ids=["one"])
    with pytest.raises(AssertionError, match="empty"):
        each_case("number", [])(test)()  # type: ignore[call-arg]
