"""
Failures that no busy machine explains: a run that has one ends with a status of its own, and then
`./run test` tries nothing again.
"""

from __future__ import annotations

from collections.abc import Generator

import pytest

__all__ = [
    "STATUS",
    "Inexcusable",
    "pytest_runtest_logreport",
    "pytest_runtest_makereport",
    "pytest_sessionfinish",
]

# Of the run; none of pytest's own, which end at 5.
STATUS = 9

# Their tests. Reports come without their session, and there is one in a process.
SEEN: list[str] = []


class Inexcusable(AssertionError):
    """Raise it where what happened may not happen however late things are."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    report.is_inexcusable = call.excinfo is not None and call.excinfo.errisinstance(Inexcusable)
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if getattr(report, "is_inexcusable", False):
        SEEN.append(report.nodeid)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    if SEEN:
        session.exitstatus = STATUS
