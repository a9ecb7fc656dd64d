"""The fixture that says what a test left: each kind by name, and nobody else's."""

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[1]

CONFTEST = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
pytest_plugins = ["tests.support.leaks"]

def pytest_configure():
    import tests.support.leaks
    tests.support.leaks.MOMENT = 0.1
"""

TESTS = """
import asyncio, os, socket, subprocess, threading
import pytest

kept = []

@pytest.fixture(scope="module")
def shared():
    with socket.socket() as made:
        yield made

def test_wide(shared):
    pass

def test_descriptor():
    kept.append(open("left.txt", "w"))

def test_socket():
    kept.append(socket.create_server(("127.0.0.1", 0)))

def test_thread():
    kept.append(threading.Event())
    threading.Thread(target=kept[-1].wait, name="left thread", daemon=True).start()

def test_process():
    kept.append(subprocess.Popen(["sleep", "60"]))

def test_unwaited():
    kept.append(subprocess.Popen(["true"]))

def test_task():
    async def forgotten():
        await asyncio.sleep(60)
    async def main():
        kept.append(asyncio.create_task(forgotten(), name="left task"))
    asyncio.run(main())

def test_timer():
    async def main():
        asyncio.get_running_loop().call_later(60, print)
    asyncio.run(main())

def test_loop():
    kept.append(asyncio.new_event_loop())

def test_garbage():
    circle = [socket.socket()]
    circle.append(circle)

def test_short():
    threading.Timer(0.02, int).start()

def test_clean(shared):
    with socket.socket():
        asyncio.run(asyncio.sleep(0))

def test_end():
    for each in kept:
        if isinstance(each, subprocess.Popen):
            each.kill()
            each.wait()
"""

LEFT = {
    "test_descriptor": "*left behind: descriptor *left.txt*",
    "test_socket": "*left behind: descriptor *SOCK_STREAM ('127.0.0.1', *",
    "test_thread": "*left behind: thread 'left thread'*",
    "test_process": "*left behind: process *: sleep 60*",
    "test_unwaited": "*left behind: process * that has ended and was not waited for*",
    "test_task": "*left behind: task 'left task': *forgotten*",
    "test_timer": "*left behind: timer <TimerHandle *print*",
    "test_loop": "*left behind: event loop *",
    "test_garbage": "*unclosed <socket*",
}


def test_each_leak_is_reported_with_the_name_of_its_test(pytester: pytest.Pytester) -> None:
    pytester.makeini("[pytest]\nfilterwarnings = error\naddopts = -p no:hypothesispytest")
    pytester.makeconftest(CONFTEST)
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_subprocess("-rE")
    result.assert_outcomes(passed=13, errors=len(LEFT))
    for test, text in LEFT.items():
        result.stdout.fnmatch_lines([f"*ERROR at teardown of {test} *", text])
