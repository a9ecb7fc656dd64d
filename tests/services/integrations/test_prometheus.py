"""Metrics, as Prometheus's own parser reads them, beside what really happened."""

import asyncio
import contextlib
import dataclasses
import gc
import math
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPException
from pathlib import Path
from typing import Any

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import Metric, Sample
from prometheus_client.openmetrics.exposition import generate_latest as generate_openmetrics
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Fleet,
    Gateway,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    Mapping,
    ModbusTimeoutError,
    Route,
    Server,
)
from libmodbus_py.client.statistics import TIME_BOUNDS
from libmodbus_py.services.integrations import prometheus
from libmodbus_py.services.integrations.metrics import OF_ATTRIBUTES
from libmodbus_py.services.integrations.prometheus import Collector, collect, exposing
from libmodbus_py.tools import timed_server
from libmodbus_py.version import how_to_add
from tests.services.fleet.fleets import Peer, in_simulated_time, meter
from tests.services.fleet.fleets import until as until_simulated
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted, Write
from tests.simulation.sockets import DELAY
from tests.support.cases import each_case
from tests.support.certificates import Pki
from tests.support.commands import Started, run
from tests.support.names import NEEDS_IPV6
from tests.support.peers import echo, until

# To a peer in memory and back.
WAY = 2 * DELAY

DEVICE = Device(Mapping(holding_registers=100, coils=8))

Scraped = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def values(registry: CollectorRegistry) -> Scraped:
    return parsed(generate_latest(registry).decode())


def parsed(text: str) -> Scraped:
    """Name and labels -> value; each may be there once."""
    samples: Scraped = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            key = sample.name, tuple(sorted(sample.labels.items()))
            assert key not in samples, key
            samples[key] = sample.value
    return samples


def of(samples: Scraped, name: str, /, **labels: str) -> float:
    return samples[name, tuple(sorted(labels.items()))]


def of_client(samples: Scraped, name: str, endpoint: str, **labels: str) -> float:
    return of(samples, f"modbus_client_{name}", endpoint=endpoint, **labels)


def histogram(samples: Scraped, endpoint: str) -> list[float]:
    name = "request_duration_seconds_bucket"
    return [of_client(samples, name, endpoint, le=f"{bound}") for bound in [*TIME_BOUNDS, "+Inf"]]


@pytest.fixture
def registry() -> CollectorRegistry:
    return CollectorRegistry(auto_describe=True)


@contextlib.contextmanager
def served(**options: Any) -> Iterator[tuple[Server, str]]:
    server = Server(DEVICE, **options)
    with server.background("tcp://127.0.0.1:0") as running:
        yield server, running.urls[0]


def test_metrics_of_both_clients_and_the_server_match_the_requests(registry: CollectorRegistry):
    async def ask(url: str) -> Scraped:
        async with AsyncClient(url) as plc:
            collect(plc, registry=registry)
            await asyncio.gather(*(plc.read_holding_registers(0, 1) for _ in range(20)))
            with pytest.raises(IllegalDataAddress):
                await plc.read_holding_registers(200, 1)
            return values(registry)

    with served() as (server, url), Client(url, unit=1) as plc:
        collect(server, plc, registry=registry)
        start = time.monotonic()
        for _ in range(5):
            plc.write_coil(0, True)
            plc.read_coils(0, 8)
        with pytest.raises(IllegalDataAddress):
            plc.read_coils(7, 2)
        passed = time.monotonic() - start
        before = values(registry)
        after = asyncio.run(ask(url))
    assert of_client(before, "requests_total", url, function="1", result="ok") == 5
    assert of_client(before, "requests_total", url, function="5", result="ok") == 5
    assert of_client(before, "requests_total", url, function="1", result="exception") == 1
    assert of_client(before, "requests_sent_total", url) == 11
    assert of_client(before, "responses_total", url) == 11
    assert of_client(before, "exceptions_total", url) == 1
    assert of_client(before, "connects_total", url) == 1
    counts = histogram(before, url)
    assert counts == sorted(counts)
    assert counts[-1] == of_client(before, "request_duration_seconds_count", url) == 11
    assert 0 < of_client(before, "request_duration_seconds_sum", url) <= passed
    assert of(before, "modbus_server_requests_total") == 11
    assert of(before, "modbus_server_refused_total") == 1
    assert of(before, "modbus_server_connections") == 1
    # Both clients have the same endpoint: they add up.
    assert of_client(after, "requests_total", url, function="3", result="ok") == 20
    assert of_client(after, "requests_total", url, function="3", result="exception") == 1
    assert of_client(after, "requests_total", url, function="1", result="ok") == 5
    assert of_client(after, "requests_sent_total", url) == 32
    assert histogram(after, url)[-1] == 32
    assert of(after, "modbus_server_connections") == 2
    assert of(after, "modbus_server_accepted_total") == 2
    assert of(after, "modbus_server_requests_total") == 32


def test_the_histogram_counts_each_answer_in_its_interval(registry: CollectorRegistry) -> None:
    """Each bound longer than the network delay has an answer just below it."""
    network = Network()
    took = [0.9 * bound for bound in TIME_BOUNDS if bound > 2 * WAY]
    delays = [*(seconds - WAY for seconds in took), 60.0]

    def late(request: bytes, write: Write) -> None:
        write(echo(request), after=delays[len(peer.requests) - 1])

    peer = Scripted(network, "tcp://10.0.0.1", late)
    with network.installed(), Client(peer.url, timeout=30) as plc:
        collect(plc, registry=registry)
        for _ in took:
            plc.read_holding_registers(0, 1)
        with pytest.raises(ModbusTimeoutError):
            plc.read_holding_registers(0, 1)
        samples = values(registry)
    below = [sum(seconds <= bound for seconds in took) for bound in TIME_BOUNDS]
    assert histogram(samples, peer.url) == [*below, len(took)]
    total = of_client(samples, "request_duration_seconds_sum", peer.url)
    assert total == pytest.approx(sum(took))
    timeouts = of_client(samples, "requests_total", peer.url, function="3", result="timeout")
    assert timeouts == of_client(samples, "timeouts_total", peer.url)


def test_the_last_success_is_given_as_a_time_of_day(registry: CollectorRegistry) -> None:
    name = "modbus_client_last_success_timestamp_seconds"
    with served() as (_, url), Client(url) as plc:
        collect(plc, registry=registry)
        assert not [key for key in values(registry) if key[0] == name]
        before = time.time()
        plc.read_coils(0, 1)
        with Client(url) as other:  # of two the later
            collect(other, registry=registry)
            other.read_coils(0, 1)
            # The clocks may be set against each other meanwhile.
            assert before - 1 <= of(values(registry), name, endpoint=url) <= time.time() + 1


@each_case("kind", OF_ATTRIBUTES)
def test_every_number_of_statistics_has_a_metric(kind: type) -> None:
    numbers = {field.name for field in dataclasses.fields(kind) if field.type in ("int", "bool")}
    assert numbers <= OF_ATTRIBUTES[kind].keys()


def test_names_and_texts_follow_the_rules_of_prometheus(registry: CollectorRegistry) -> None:
    fleet = Fleet()
    with served() as (server, url), Client(url) as plc:
        plc.read_coils(0, 1)
        collect(server, plc, fleet, registry=registry)
        text = generate_latest(registry).decode()
    families = {item.name: item for item in text_string_to_metric_families(text)}
    assert families["modbus_client_requests_sent"].type == "counter"
    assert families["modbus_server_connections"].type == "gauge"
    assert families["modbus_server_connections"].documentation == (
        "TCP connections that are open now."
    )
    for line in text.splitlines():
        if not line.startswith("#"):
            assert re.match(r"modbus_(client|server|fleet)_[a-z_]+[ {]", line)
    # The stricter form of the same parser.
    strict = [*parse_openmetrics(generate_openmetrics(registry).decode())]
    assert {entry.name for entry in strict} == families.keys()


def test_the_end_of_a_certificate_is_a_metric_while_its_endpoint_is_open(
    registry: CollectorRegistry, tmp_path: Path
) -> None:
    security = Pki(tmp_path).server()
    server = Server(Device(Mapping()), security=security)
    collect(server, registry=registry)
    name = "modbus_server_certificate_end_timestamp_seconds"
    with server.background("tls://127.0.0.1:0") as running:
        assert registry.get_sample_value(name, {"endpoint": running.urls[0]}) == security.ends
    assert name not in {metric for metric, _ in values(registry)}


def test_endpoints_are_labels_without_settings(registry: CollectorRegistry) -> None:
    plc = Client("rtu:///dev/null?baudrate=9600&timeout=0.1")
    collect(plc, Client("tcp://[::1]:1502?unit=3"), registry=registry)
    labels = {dict(labels).get("endpoint") for _, labels in values(registry)}
    assert labels == {"rtu:///dev/null"}  # no device has the other label
    plc.close()


def test_names_distinguish_servers_and_equal_names_are_summed(registry: CollectorRegistry) -> None:
    servers = [Server(DEVICE) for _ in range(5)]
    for number, server in enumerate(servers):
        server.statistics.accepted = 10**number
    collect(servers[0], servers[1], registry=registry)
    collect(servers[2], servers[3], name="boilers", registry=registry)
    collect(servers[4], name="pumps", registry=registry)
    name = "modbus_server_accepted_total"
    samples = {labels: value for (item, labels), value in values(registry).items() if item == name}
    assert samples == {(): 11, (("server", "boilers"),): 1100, (("server", "pumps"),): 10000}


def test_a_client_is_counted_once_however_often_it_is_added(registry: CollectorRegistry) -> None:
    with served() as (_, url), Client(url) as plc:
        for entry in (plc, plc, plc.for_unit(2)):
            collect(entry, registry=registry)
        plc.read_coils(0, 1)
        plc.for_unit(9).read_coils(0, 1)
        assert of_client(values(registry), "requests_sent_total", url) == 2


def test_a_counter_does_not_fall_when_one_of_two_clients_is_dropped(registry: CollectorRegistry):
    """Prometheus would take a lower value for a restart, and count the rest again."""
    name = "requests_sent_total"
    with served() as (_, url), Client(url) as stays:
        collect(stays, registry=registry)
        stays.read_coils(0, 1)
        for already in (0, 3, 6):
            with Client(url) as plc:
                collect(plc, registry=registry)
                for _ in range(3):
                    plc.read_coils(0, 1)
                assert of_client(values(registry), name, url) == 1 + already + 3
            del plc
            gc.collect()
            assert of_client(values(registry), name, url) == 1 + already + 3
            assert histogram(values(registry), url)[-1] == 1 + already + 3
    del stays
    gc.collect()
    assert not values(registry)


def test_clients_that_come_and_go_leave_nothing_without_a_scrape(registry: CollectorRegistry):
    stays = Client("tcp://127.0.0.1:1")
    collector = collect(stays, registry=registry)
    for turn in range(200):
        for port in ("1", "2"):
            collect(Client(f"tcp://127.0.0.1:{port}"), registry=registry)
        if turn in (100, 199):
            gc.collect()
            collect(stays, registry=registry)
            holders = [var for var in vars(collector).values() if hasattr(var, "__len__")]
            assert max(map(len, holders)) <= 3
    stays.close()


def test_an_object_that_is_neither_client_nor_server_is_refused(registry: CollectorRegistry):
    server = Server(DEVICE)
    for wrong in (DEVICE, None, "tcp://127.0.0.1"):
        with pytest.raises(TypeError, match="objects must be clients, servers, gateways or fleets"):
            collect(server, wrong, registry=registry)  # type: ignore[arg-type]
    assert not values(registry)  # not the first one without the others


def test_a_registry_has_one_collector_and_knows_its_names(registry: CollectorRegistry) -> None:
    server = Server(DEVICE)
    assert collect(server, registry=registry) is collect(registry=registry)
    other = CollectorRegistry()
    assert collect(server, registry=other) is not collect(registry=registry)
    assert of(values(other), "modbus_server_requests_total") == 0
    with pytest.raises(ValueError, match="modbus_client_requests"):
        registry.register(Collector())


def test_scrapes_during_load_are_right_and_never_decrease(registry: CollectorRegistry) -> None:
    """Two threads ask, two scrape."""

    def ask(client: Client) -> None:
        for turn in range(200):
            client.write_register(turn % 100, turn)

    def scrape() -> list[float]:
        counts = []
        while not all(entry.done() for entry in asking):
            counts.append(of(values(registry), "modbus_server_requests_total"))
        return counts

    with contextlib.ExitStack() as stack:
        server, url = stack.enter_context(served())
        clients = [stack.enter_context(Client(url)) for _ in range(2)]
        collect(server, *clients, registry=registry)
        threads = stack.enter_context(ThreadPoolExecutor(4))
        asking = [threads.submit(ask, client) for client in clients]
        for thread in [threads.submit(scrape) for _ in range(2)]:
            assert thread.result() == sorted(thread.result())
        assert [future.result() for future in asking] == [None, None]
        now = values(registry)
    assert of_client(now, "requests_total", url, function="6", result="ok") == 400
    assert of(now, "modbus_server_requests_total") == 400


def fetched(url: str) -> Scraped:
    with urllib.request.urlopen(url, timeout=20) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain")
        return parsed(answer.read().decode())


@pytest.mark.parametrize("host", ["127.0.0.1", pytest.param("::1", marks=NEEDS_IPV6)])
def test_metrics_are_available_inside_the_block(registry: CollectorRegistry, host: str) -> None:
    server = Server(DEVICE)
    collect(server, registry=registry)
    threads = threading.active_count()
    with exposing(host, 0, registry) as url:
        assert of(fetched(url), "modbus_server_connections") == 0
        assert host in url
    until(lambda: threading.active_count() <= threads)  # a timer that was cancelled ends soon
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url, timeout=5)


def test_a_scrape_that_stalls_delays_no_other(registry: CollectorRegistry, monkeypatch) -> None:
    """Two servers of one program, and each has clients that never finish their request."""
    monkeypatch.setattr(prometheus, "LIMIT_S", 3600.0)
    with contextlib.ExitStack() as stack:
        urls = [stack.enter_context(exposing("127.0.0.1", 0, registry)) for _ in range(2)]
        for url in urls:
            port = int(url.split(":")[2].partition("/")[0])
            for _ in range(30):
                stalled = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
                stalled.sendall(b"GET /metrics HTTP/1.1\r\n")
        for url in urls * 3:
            fetched(url)


class Slow:
    """A collector with so many samples, each of which takes a time."""

    def __init__(self, count: float, seconds: float = 0.0) -> None:
        self.count, self.seconds = count, seconds
        self.is_asked = threading.Event()

    def collect(self) -> Iterator[Metric]:
        metric = Metric("slow", "A large family.", "gauge")
        metric.samples = self  # type: ignore[assignment]
        yield metric

    def __iter__(self) -> Iterator[Sample]:
        at = 0
        while at < self.count:
            self.is_asked.set()
            time.sleep(self.seconds)
            yield Sample("slow", {"at": f"{at:09999}"}, 1.0)
            at += 1


@pytest.fixture
def short_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prometheus, "LIMIT_S", 0.1)
    monkeypatch.setattr(timed_server, "SWEEP", 0.01)


@pytest.mark.usefixtures("short_limit")
def test_an_answer_may_last_longer_than_the_timeout_of_a_client(registry: CollectorRegistry):
    registry.register(Slow(10, seconds=0.05))
    with exposing("127.0.0.1", 0, registry) as url:
        assert len(fetched(url)) == 10


@pytest.mark.usefixtures("short_limit")
def test_a_client_that_does_not_read_the_answer_is_disconnected(registry: CollectorRegistry):
    registry.register(Slow(2000))
    with exposing("127.0.0.1", 0, registry) as url:
        port = int(url.split(":")[2].partition("/")[0])
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.settimeout(20)
            client.sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
            client.recv(1)
            time.sleep(0.5)
            size = 1
            with contextlib.suppress(ConnectionResetError):
                while data := client.recv(1 << 20):
                    size += len(data)
    assert size < 2000 * 10_000


def test_an_infinite_answer_ends_with_the_server(registry: CollectorRegistry) -> None:
    endless = Slow(math.inf)
    registry.register(endless)
    with ThreadPoolExecutor(1) as threads:
        with exposing("127.0.0.1", 0, registry) as url:
            client = threads.submit(urllib.request.urlopen, url, timeout=20)
            assert endless.is_asked.wait(20)
        assert isinstance(client.exception(), OSError | HTTPException)


ARGUMENTS = ["serve", "tcp://127.0.0.1:0"]


@pytest.mark.parametrize(
    ("address", "stop"),
    [("127.0.0.1:0", signal.SIGTERM), pytest.param("[::1]:0", signal.SIGINT, marks=NEEDS_IPV6)],
)
def test_serve_exposes_its_metrics(address: str, stop: int) -> None:
    with Started(*ARGUMENTS, "--metrics", address) as process:
        line = process.stdout.readline()
        match = re.fullmatch(r"metrics on (http://(\S+):\d+/metrics)\n", line)
        assert match, line
        assert match[2] == address.removesuffix(":0")
        url = process.stdout.readline().removeprefix("listening on ").rstrip("\n")
        with Client(url, timeout=5) as plc:
            plc.read_holding_registers(0, 1)
            scraped = fetched(match[1])
        assert of(scraped, "modbus_server_requests_total") == 1
        assert of(scraped, "modbus_server_connections") == 1
        assert ("process_open_fds", ()) in scraped
        process.send_signal(stop)
        assert (process.wait(), process.stderr.read()) == (0, "")


def test_serve_reports_that_the_port_of_metrics_is_in_use() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = f"127.0.0.1:{listener.getsockname()[1]}"
        message = f"libmodbus-py: cannot listen for metrics on {place}: Address already in use\n"
        assert run(*ARGUMENTS, "--metrics", place) == (1, "", message)


def test_serve_says_which_extra_is_missing() -> None:
    program = (
        "import sys; sys.modules['prometheus_client'] = None\n"
        "from libmodbus_py.cli.main import main\n"
        "sys.exit(main(['serve', 'tcp://127.0.0.1:0', '--metrics', '127.0.0.1:0']))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (1, "")
    message = f"the exporter needs prometheus_client: {how_to_add('metrics')}"
    assert result.stderr == f"libmodbus-py: {message}\n"


@in_simulated_time
async def test_each_device_has_one_metric_until_its_fleet_is_removed() -> None:
    registry = CollectorRegistry()
    async with Peer() as peer:
        one, other = meter("a", peer.url, labels={"site 1": "Halle"}), meter("b", peer.url, unit=2)
        fleets = [Fleet([one]), Fleet([one, other])]
        collect(*fleets, *fleets, registry=registry)
        async with fleets[0], fleets[1]:
            early = values(registry)
            assert of(early, "modbus_fleet_device_up", device="b") == 0
            assert of(early, "modbus_fleet_device_down", device="b", reason="NotPolledYet") == 1
            await until_simulated(lambda: min(fleet.statistics.readings for fleet in fleets) > 5)
            samples = values(registry)
            assert of(samples, "modbus_fleet_polls_total") > 2
            assert of(samples, "modbus_fleet_device_up", device="a", site_1="Halle") == 1
            labels = {"device": "a", "site_1": "Halle", "name": "power", "unit": "W"}
            assert of(samples, "modbus_fleet_value", **labels) == 7
            assert "modbus_fleet_device_down" not in {name for name, _ in samples}
            second = CollectorRegistry()
            collect(fleets[0], name="north", registry=second)
            labels = {"device": "a", "site_1": "Halle", "fleet": "north"}
            assert of(values(second), "modbus_fleet_device_up", **labels) == 1
        fleets.clear()
        gc.collect()
        assert not values(registry)


def test_a_gateway_has_metrics_of_its_lines_and_units() -> None:
    registry = CollectorRegistry()
    with Server({5: DEVICE}).background("tcp://127.0.0.1:0") as behind:
        line = behind.urls[0]
        gateway = Gateway([Route(f"{line}?timeout=2", units=range(5, 7))])
        collect(gateway, registry=registry, name="hall")
        with (
            gateway.background("tcp://127.0.0.1:0") as running,
            Client(running.urls[0], unit=5) as plc,
        ):
            for _ in range(3):
                plc.read_holding_registers(0, 1)
            with pytest.raises(IllegalDataAddress):
                plc.read_holding_registers(100, 1)
            with pytest.raises(GatewayTargetFailedToRespond):
                plc.for_unit(6).read_coils(0, 1)
            samples = values(registry)
    of_gateway = {name: count for (name, labels), count in samples.items() if not labels[1:]}
    assert of_gateway["modbus_gateway_requests_total"] == 5
    place = (("line", line), ("server", "hall"))
    assert samples["modbus_gateway_line_full_total", place] == 0
    assert samples["modbus_gateway_line_waiting", place] == 0
    unit = (*place, ("unit", "5"))
    assert samples["modbus_gateway_unit_requests_total", unit] == 4
    assert samples["modbus_gateway_unit_exceptions_total", unit] == 1
    assert samples["modbus_gateway_unit_is_silent", unit] == 0
    client = (("endpoint", line), ("server", "hall"))
    assert samples["modbus_client_connects_total", client] == 1
    assert samples["modbus_server_accepted_total", (("server", "hall"),)] == 1
