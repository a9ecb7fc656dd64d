"""
The loop over a table of cases: one test that tries them all, and names those that failed.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from tests.support.cases import each


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
