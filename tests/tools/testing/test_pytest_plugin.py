"""The pytest plugin in suites of others: what reports show, and what it leaves behind."""

import re
import runpy
import sys
from collections.abc import Callable

import pytest

from libmodbus_py.tools.testing import plugin
from tests.support.programs import run_to_end

pytest_plugins = ["pytester"]

HEAD = """
    import os, signal, threading, time
    import pytest
    from libmodbus_py import Client, Fault

    def read(server, count=1):
        with Client(server.url) as plc:
            plc.read_holding_registers(0, count)
"""

Suite = pytest.Pytester
Write = Callable[[str], object]

READ_TEXT = "unit 1: ReadHoldingRegisters(address=0, count=1) -> [[]0[]]"


@pytest.fixture
def suite(pytester: Suite) -> Suite:
    """A suite for which every warning is an error; without a plugin that takes a second to load."""
    # An editable installation says that the package has the tests, too, which are imported here.
    ignored = "ignore:Module already imported:pytest.PytestAssertRewriteWarning"
    pytester.makeini(
        f"[pytest]\nfilterwarnings =\n    error\n    {ignored}\naddopts = -p no:hypothesispytest"
    )
    return pytester


@pytest.fixture
def write(suite: Suite) -> Write:
    return lambda tests: suite.makepyfile(HEAD + tests)


class TestReports:
    @pytest.mark.parametrize("options", [[], ["-n2"]], ids=["here", "in workers"])
    def test_a_failing_test_shows_what_passed_at_its_servers(
        self, suite: Suite, write: Write, options: list[str]
    ) -> None:
        write("""
    def test_other(modbus_server):
        read(modbus_server, 3)

    def test_failing(modbus_server, make_modbus_server, modbus_faults):
        make_modbus_server("rtu+tcp://127.0.0.1:0")
        read(modbus_server)
        with modbus_faults.switch_on(Fault("exception", code=2)):
            read(modbus_server)
        """)
        result = suite.runpytest(*options)
        result.assert_outcomes(passed=1, failed=1)
        result.stdout.fnmatch_lines(
            [
                "*- modbus transactions -*",
                "tcp://127.0.0.1:*",
                READ_TEXT,
                "unit 1: ReadHoldingRegisters(address=0, count=1)"
                " -> illegal data address (exception 2)",
                "rtu+tcp://127.0.0.1:* none",
            ],
            consecutive=True,
        )
        result.stdout.no_fnmatch_line("*count=3*")

    def test_a_test_that_fails_in_its_setup_or_teardown_shows_traffic(
        self, suite: Suite, write: Write
    ) -> None:
        write("""
    @pytest.fixture
    def early(modbus_server):
        read(modbus_server)
        assert False

    @pytest.fixture
    def late(modbus_server):
        yield
        read(modbus_server)
        assert False

    def test_early(early): pass
    def test_late(late): pass
        """)
        result = suite.runpytest()
        result.assert_outcomes(passed=1, errors=2)
        assert len(re.findall("- modbus transactions -", result.stdout.str())) == 2
        result.stdout.fnmatch_lines(["*test_early*", READ_TEXT, "*test_late*", READ_TEXT])

    def test_a_test_that_passes_shows_no_traffic(self, suite: Suite, write: Write) -> None:
        write("""
    def test_good(modbus_server): read(modbus_server)
    def test_without(): assert False
    def test_skipped(modbus_server): pytest.skip()

    @pytest.mark.xfail(reason="known", strict=True)
    def test_known(modbus_server): assert False
        """)
        result = suite.runpytest("-rA")
        result.assert_outcomes(passed=1, failed=1, skipped=1, xfailed=1)
        result.stdout.no_fnmatch_line("*modbus transactions*")

    def test_the_last_fifty_transactions_are_shown_in_short(self, suite: Suite, write: Write):
        write("""
    def test_many(modbus_server):
        with Client(modbus_server.url) as plc:
            for address in range(60):
                plc.read_holding_registers(address, 125)
        assert False
        """)
        lines = suite.runpytest().outlines
        requests = [line for line in lines if line.startswith("unit 1: ReadHoldingRegisters(")]
        assert len(requests) == 50
        assert "address=10," in requests[0]
        assert "... 10 earlier ones" in lines
        assert all(len(line) < 170 and line.endswith("...") for line in requests)

    def test_a_late_answer_is_marked_as_late(self, suite: Suite, write: Write) -> None:
        write("""
    def test_late(modbus_server, modbus_faults):
        modbus_faults.switch_on(Fault("delay", seconds=0.2))
        read(modbus_server)
        assert False
        """)
        suite.runpytest().stdout.fnmatch_lines([f"{READ_TEXT} after 0.[2-9]?? s"])


class TestLeftBehind:
    def test_many_tests_leave_no_thread_and_no_descriptor(self, suite: Suite, write: Write) -> None:
        write("""
    import gc
    from libmodbus_py.tools.testing.recording import RecordingServer

    FOUND = []

    def there_is():
        return threading.active_count(), len(os.listdir("/proc/self/fd"))

    @pytest.mark.parametrize("number", range(60))
    def test_it(number, request):
        if number > 1:
            FOUND.append(there_is())
        server = request.getfixturevalue("modbus_server")
        if number % 10 == 7:
            request.getfixturevalue("modbus_serial_line")
        read(server)

    def test_nothing_is_left():
        assert len(set(FOUND)) == 1, FOUND
        gc.collect()
        assert not [each for each in gc.get_objects() if isinstance(each, RecordingServer)]
        """)
        suite.runpytest("-q").assert_outcomes(passed=61)

    def test_child_processes_show_no_traffic(self, suite: Suite, write: Write) -> None:
        write("""
    LEFT = []

    def test_children(modbus_server):
        read(modbus_server)
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(writer)
            os.read(reader, 1)  # lives on until the end of the run
            os._exit(0)
        LEFT.extend((child, reader, writer))
        modbus_server.close()
        with pytest.raises(ConnectionError):
            read(modbus_server)

    def test_nothing_is_left():
        child, reader, writer = LEFT
        os.close(writer)
        os.waitpid(child, 0)
        os.close(reader)
        assert [each.name for each in threading.enumerate() if "modbus" in each.name] == []
        """)
        # Python 3.12 warns of any fork beside threads.
        suite.runpytest_subprocess("-W", "ignore::DeprecationWarning").assert_outcomes(passed=2)

    def test_an_interrupted_run_shows_no_traffic(self, suite: Suite, write: Write) -> None:
        write("""
    def test_it(modbus_server, modbus_serial_line):
        signal.signal(signal.SIGINT, signal.default_int_handler)
        read(modbus_server)
        signal.raise_signal(signal.SIGINT)
        """)
        suite.makeconftest(
            """
            import threading
            def pytest_unconfigure():
                left = [each.name for each in threading.enumerate() if "modbus" in each.name]
                print("left:", left)
            """
        )
        result = suite.runpytest_inprocess("-s", no_reraise_ctrlc=True)
        assert result.ret == pytest.ExitCode.INTERRUPTED
        result.stdout.fnmatch_lines_random(["*KeyboardInterrupt*", "left: [[][]]"])

    def test_a_hanging_test_is_ended_and_shows_its_traffic(self, suite: Suite, write: Write):
        write("""
    @pytest.mark.timeout(60)
    def test_hanging(modbus_server, modbus_faults):
        modbus_faults.switch_on(Fault("no_answer"))
        # The signal by which pytest-timeout ends a test, once the request has come.
        def alarm():
            while not modbus_server.transactions:
                time.sleep(0.001)
            signal.pthread_kill(threading.main_thread().ident, signal.SIGALRM)
        threading.Thread(target=alarm).start()
        with Client(modbus_server.url, timeout=600) as plc:
            plc.read_coils(0, 1)

    def test_next(modbus_server): read(modbus_server)
        """)
        result = suite.runpytest_subprocess()
        result.assert_outcomes(passed=1, failed=1)
        result.stdout.fnmatch_lines(["*Timeout (>60*"])
        result.stdout.fnmatch_lines(["unit 1: ReadCoils(address=0, count=1) -> no answer"])


class TestOthers:
    def test_the_plugin_can_be_switched_off(self, suite: Suite, write: Write) -> None:
        write("\n    def test_it(modbus_server): pass\n")
        result = suite.runpytest("-p", "no:libmodbus_py")
        result.assert_outcomes(errors=1)
        result.stdout.fnmatch_lines(["*fixture 'modbus_server' not found*"])

    def test_the_plugin_defines_one_hook_and_no_name_of_other_plugins(self) -> None:
        names = [name for name in vars(plugin) if name.startswith("pytest_")]
        assert names == ["pytest_runtest_makereport"]
        # Of the plugin of the package modbus-connection.
        assert not {"mock_modbus_connection", "mock_modbus_unit"} & set(vars(plugin))


class TestImports:
    def test_a_run_without_fixtures_does_not_import_the_package(self) -> None:
        code = (
            "import pytest, sys; before = set(sys.modules);"
            "import libmodbus_py.tools.testing.plugin;"
            "print(*sorted(set(sys.modules) - before))"
        )
        loaded = run_to_end(sys.executable, "-c", code).stdout.split()
        assert "libmodbus_py.tools.testing.plugin" in loaded
        ours = {name.split(".")[1] for name in loaded if name.startswith("libmodbus_py.")}
        assert not ours & {"binding", "client", "server", "device", "listener", "ports"}
        assert not {"asyncio", "ssl", "_cffi_backend"} & set(loaded)


def test_the_plugin_refuses_an_older_pytest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(pytest, "StashKey")  # which pytest 7 brought
    monkeypatch.setattr(pytest, "__version__", "6.2.5")
    with pytest.raises(pytest.UsageError, match=r"need pytest 7 or newer, not 6\.2\.5"):
        runpy.run_path(plugin.__file__, run_name="libmodbus_py.tools.testing.plugin")
