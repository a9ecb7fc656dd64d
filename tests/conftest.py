"""What the tests share: a device with known contents, and a server for it on every transport."""

import asyncio
import gc
import inspect
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.client import ids
from libmodbus_py.client.history import forget_lines
from libmodbus_py.contexts import rtu
from tests.simulation.lan import Lan
from tests.support.c_programs import SOURCES, compile_c
from tests.support.certificates import Pki
from tests.support.clients import KINDS, Connect, connecting
from tests.support.leaks import freeze
from tests.support.transports import serving

pytest_plugins = ["tests.support.golden", "tests.support.leaks", "tests.support.time_limits"]

UNIT = 17

# A shell's background jobs ignore Ctrl-C, and what nohup runs ignores SIGHUP; so would the programs
# that tests start, and end with these signals.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


# A busy machine may take any time for an example. What else holds is as hypothesis has it, which
# goes by where it runs.
settings.register_profile("suite", settings(), deadline=None)
settings.load_profile("suite")


def pytest_collection_finish() -> None:
    """Exclude collected tests from later garbage collections, which they would slow down."""
    gc.collect()
    freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tests that take longest, so that the last ones are short."""
    items.sort(key=_longest, reverse=True)


def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine function in an event loop."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    asyncio.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


def _longest(item: pytest.Item) -> float:
    mark = item.get_closest_marker("timeout")
    return float(mark.args[0]) if mark else 0.0


@pytest.fixture(autouse=True)
def _own_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the histories of lines: another test may have the same port, or the same clock."""
    forget_lines()
    rtu._failures.clear()
    monkeypatch.setattr(ids, "first_id", lambda: 0)  # which tests can name


@pytest.fixture(scope="session", autouse=True)
def _own_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Set HOME to an empty folder: programs may write there, and the user's may be read-only."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [text for text in os.environ if text.startswith("XDG_")]:
            patch.delenv(name)
        patch.setenv("HOME", str(tmp_path_factory.mktemp("home")))
        yield


@pytest.fixture
def mapping() -> Mapping:
    """Tables that begin elsewhere than at 0, each with other contents."""
    mapping = Mapping(
        coils=range(10, 2100),
        discrete_inputs=range(20, 2100),
        holding_registers=range(100, 400),
        input_registers=range(200, 400),
    )
    mapping.coils[10:20] = [True, False, True, True, False, False, True, True, True, False]
    mapping.discrete_inputs[20:28] = [False, True, False, True, False, True, False, True]
    mapping.holding_registers[100:110] = range(1000, 1010)
    mapping.input_registers[200:210] = range(2000, 2010)
    return mapping


@pytest.fixture
def device(mapping: Mapping) -> Device:
    """The mapping, and two files, one of them with a hole."""
    return Device(mapping, files={4: range(10_000), 3: {9: 0x33CD, 10: 0x0040, 12: 7}})


@pytest.fixture
def lan() -> Iterator[Lan]:
    """A network in memory, on which seconds pass only while the test waits."""
    with Lan() as lan:
        yield lan


@pytest.fixture
def pki(tmp_path: Path) -> Pki:
    """Certificates of an authority, servers and clients, made when they are asked for."""
    return Pki(tmp_path / "pki")


@pytest.fixture(params=["tcp", "rtu+tcp", "ascii+tcp", "tls", "rtu", "ascii"])
def url(request: pytest.FixtureRequest, device: Device) -> Iterator[str]:
    """A client's URL for unit 17 of a server, over each transport."""
    with serving(request.param, Server({UNIT: device})) as url:
        yield url


@pytest.fixture(params=KINDS)
def connect(request: pytest.FixtureRequest) -> Iterator[Connect]:
    """Makes clients of one kind: for what holds for both."""
    with connecting(request.param) as connect:
        yield connect


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Gives the program of a source in tests/c, compiled once."""
    directory = tmp_path_factory.mktemp("c")

    def get(name: str) -> Path:
        program = directory / name
        return program if program.exists() else compile_c(SOURCES / f"{name}.c", program)

    return get
