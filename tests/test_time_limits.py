"""A test that hangs fails, wherever it hangs and whatever it swallows, and the next one runs."""

import re
from pathlib import Path
from textwrap import dedent

import pytest

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[1]

CONFTEST = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
pytest_plugins = ["tests.support.time_limits"]

def pytest_configure():
    from tests.support import time_limits
    time_limits.AGAIN_S, time_limits.TEARDOWN_S, time_limits.LAST_S = 0.2, 0.5, {{last}}
"""

# Each test is followed by the function that its report must name.
TESTS = """
import asyncio, contextlib, socket, threading, time
import pytest
from tests.simulation.network import Network

limited = pytest.mark.timeout(0.3)
kept = []

def spin():
    while True:
        pass

async def spin_in_task():
    spin()

async def wait_in_task():
    await asyncio.Event().wait()

@limited
def test_task():  # spin_in_task
    async def main():
        await asyncio.gather(spin_in_task(), return_exceptions=True)
    asyncio.run(main())

@limited
def test_waiting_task():  # wait_in_task
    async def main():
        with contextlib.suppress(Exception):
            await asyncio.create_task(wait_in_task())
    asyncio.run(main())

@limited
def test_thread():  # wait_in_thread
    def wait_in_thread():
        kept[0].wait()
    kept.append(threading.Event())
    thread = threading.Thread(target=wait_in_thread)
    thread.start()
    try:
        thread.join()
    finally:
        kept[0].set()

@limited
def test_simulated_time():  # spin_in_task
    Network().run(spin_in_task)

@limited
def test_all_is_swallowed():  # spin
    with contextlib.suppress(BaseException):
        spin()

@pytest.fixture
def slow_to_begin():
    spin()

@limited
def test_setup(slow_to_begin):  # slow_to_begin
    pass

@pytest.fixture
def first():
    yield
    kept.append("first is torn down")

@pytest.fixture
def slow_to_end(first):
    yield
    spin()

@limited
def test_teardown(slow_to_end):  # slow_to_end
    pass

@limited
def test_teardown_after_a_failure(slow_to_end):  # slow_to_end
    assert False, "as it should"

def test_quick():
    assert kept[1:] == ["first is torn down"] * 2
"""


def write(pytester: pytest.Pytester, tests: str, last: float) -> None:
    pytester.makeini("[pytest]\nfilterwarnings = error\ntimeout = 60\n")
    pytester.makeconftest(CONFTEST.replace("{last}", str(last)))
    pytester.makepyfile(dedent(tests))


@pytest.mark.slow
def test_a_test_that_hangs_fails_and_says_where(pytester: pytest.Pytester) -> None:
    write(pytester, TESTS, 30)
    outcome = pytester.runpytest_subprocess("-p", "no:xdist", "-p", "no:libmodbus_py")
    names = re.findall(r"def (test_\w+)\(\w*\):  # (\w+)", TESTS)
    # pytest calls what fails in a setup or a teardown an error; one test has passed before that.
    outcome.assert_outcomes(passed=2, failed=len(names) - 2, errors=3)
    text = outcome.stdout.str()
    for name, place in names:
        parts = re.split(r"\n_{3,} (?:ERROR at (?:setup|teardown) of )?", text)
        reports = [part for part in parts if part.startswith(f"{name} ")]
        assert any("reached the limit of 0.3 s" in each and place in each for each in reports), name


NEVER = {
    "C code": """
        import signal
        def test_it():
            signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
            while True:
                pass
        """,
    "all that is raised": """
        import contextlib
        def test_it():
            while True:
                with contextlib.suppress(BaseException):
                    while True:
                        pass
        """,
    "a thread after the run": """
        import threading
        def test_it():
            threading.Thread(target=threading.Event().wait).start()
        """,
}


@pytest.mark.slow
@pytest.mark.parametrize("hang", NEVER)
def test_what_never_ends_ends_its_process(pytester: pytest.Pytester, hang: str) -> None:
    write(pytester, NEVER[hang], 1)
    options = ("--timeout=0.2", "-p", "no:xdist", "-p", "no:libmodbus_py")
    outcome = pytester.runpytest_subprocess(*options, timeout=60)
    assert outcome.ret == 1
    assert "Timeout (0:00:01" in outcome.stderr.str()
    assert "most recent call first" in outcome.stderr.str()


@pytest.mark.slow
def test_a_worker_that_hangs_fails_its_test_and_no_other(pytester: pytest.Pytester) -> None:
    write(pytester, dedent(NEVER["all that is raised"]) + "def test_other():\n    pass\n", 1)
    outcome = pytester.runpytest_subprocess("-n", "1", "--timeout=0.2", "-p", "no:libmodbus_py")
    outcome.assert_outcomes(passed=1, failed=1)
    outcome.stdout.fnmatch_lines(["*worker 'gw0' crashed while running '*::test_it'*"])
