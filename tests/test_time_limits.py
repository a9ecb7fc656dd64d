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
TESTS = Path(__file__).with_name("tests_that_hang.txt").read_text()


def write(pytester: pytest.Pytester, tests: str, last: float) -> None:
    pytester.makeini("[pytest]\nfilterwarnings = error\ntimeout = 60\n")
    pytester.makeconftest(CONFTEST.replace("{last}", str(last)))
    pytester.makepyfile(dedent(tests))


@pytest.mark.slow
def test_a_test_that_hangs_fails_and_names_its_place(pytester: pytest.Pytester) -> None:
    write(pytester, TESTS, 30)
    outcome = pytester.runpytest_subprocess("-p", "no:xdist", "-p", "no:libmodbus_py")
    names = re.findall(r"def (test_\w+)\(\w*\):  # (\w+)", TESTS)
    # pytest calls what fails in a setup or a teardown an error; one test has passed before that.
    outcome.assert_outcomes(passed=2, failed=len(names) - 2, errors=3)
    text = outcome.stdout.str()
    for name, place in names:
        parts = re.split(r"\n_{3,} (?:ERROR at (?:setup|teardown) of )?", text)
        reports = [part for part in parts if part.startswith(f"{name} ")]
        assert any("reached the limit of 0.3 s" in item and place in item for item in reports), name


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
def test_a_test_that_cannot_be_interrupted_ends_its_process(pytester: pytest.Pytester, hang: str):
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
