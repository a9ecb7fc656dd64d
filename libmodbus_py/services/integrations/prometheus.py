"""
The statistics of clients, servers, gateways and fleets as metrics of Prometheus.

::

    from libmodbus_py.services.integrations.prometheus import collect

    collect(server, plc)                  # adds them to the default registry of prometheus_client
    prometheus_client.start_http_server(9400)

Statistics are read when the metrics are scraped; requests do not become slower.

* ``modbus_client_requests_total{endpoint,function,result}``: the outcomes of requests;
* ``modbus_client_request_duration_seconds{endpoint}``: response times, a histogram;
* ``modbus_client_last_success_timestamp_seconds{endpoint}``: the time of the last response;
* ``modbus_client_..._total{endpoint}`` and ``modbus_server_..._total``: the counters of
  `Statistics` (`requests` is ``modbus_client_requests_sent_total``) and `ServerStatistics`;
* ``modbus_server_connections``: the open connections;
* ``modbus_server_certificate_end_timestamp_seconds{endpoint}``: the time at which the certificate
  of an endpoint expires;
* ``modbus_gateway_..._total``: the counters of `GatewayStatistics`, those of its lines with
  the label ``line``, and those of their units with ``line`` and ``unit``. The connection of a line
  also has the metrics of a client, whose ``endpoint`` is the URL of the line;
* ``modbus_fleet_...``: the counters of `FleetStatistics`, those of its outputs with the label
  ``output``, and how late polls began, a histogram;
* ``modbus_fleet_value{device,name,unit}``: the last values of the points of a fleet
  (`LastValues`), as far as they are good and numbers, with the labels of their devices.
"""

from __future__ import annotations

import contextlib
import inspect
import re
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from itertools import accumulate
from operator import add
from typing import Any, NamedTuple, Protocol

from ...client.statistics import TIME_BOUNDS, Statistics
from ...protocol.extras import what_is_missing
from ...server.limits import ServerStatistics
from ...tools.timed_server import TimedServer
from ..fleet.config import label_name
from ..fleet.statistics import (
    LATENESS_BOUNDS,
    FleetStatistics,
    JournalStatistics,
    KeptReadings,
    OutputStatistics,
)
from ..gateway.statistics import GatewayStatistics, LineStatistics, UnitStatistics

try:
    from prometheus_client import REGISTRY, CollectorRegistry, MetricsHandler
    from prometheus_client.core import Metric
    from prometheus_client.registry import Collector as _Collector
except ImportError as error:
    raise ImportError(what_is_missing("the exporter", "metrics")) from error

__all__ = ["Collector", "collect", "exposing"]

# Seconds that an HTTP request for metrics and its response may take.
LIMIT_S = 3.0

Labels = tuple[tuple[str, str], ...]


class Counted(Protocol):
    """A client, a server, a gateway or a fleet; a gateway also has `traffic`."""

    @property
    def statistics(self) -> Any: ...


class Family(NamedTuple):
    """A metric: its name, its type ("counter", "gauge" or "histogram") and its help text."""

    name: str
    type: str
    text: str
    # Combines the values of two objects with the same labels.
    together: Callable[[float, float], float] = add


class Sample(NamedTuple):
    """One value of a metric; values of equal samples are combined."""

    family: Family
    suffix: str
    labels: Labels


Values = Iterable[tuple[Sample, float]]


class MetricKind(NamedTuple):
    """
    The metrics of one class of statistics.

    Attributes:
        families: the metrics.
        read: returns the values of statistics, with the labels given as its second argument.
        label: the label with the name that an object was given; empty if there is none.
    """

    families: list[Family]
    read: Callable[[Any, Labels], Values]
    label: str = ""


# --- the metrics ---------------------------------------------------------------------------


def _texts(kind: type) -> dict[str, str]:
    """Return the help texts of attributes: their descriptions in the docstring of a class."""
    section = re.split(r"\nAttributes:\n", inspect.getdoc(kind) or "")[-1]
    found = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", section, re.MULTILINE)
    return {name: text[0].upper() + re.sub(r"\s+", " ", text[1:]) for name, text in found}


def _counters(
    prefix: str, kind: type, without: Iterable[str] = (), gauges: Iterable[str] = ()
) -> dict[str, Family]:
    """Return the metrics of the attributes of a class, by attribute."""
    texts = _texts(kind)
    return {
        each.name: Family(
            f"{prefix}_{each.name}",
            "gauge" if each.name in gauges else "counter",
            texts.get(each.name, each.name),
        )
        for each in fields(kind)
        if each.name not in without
    }


CLIENT = _counters(
    "modbus_client", Statistics, ("results", "answer_times", "answer_seconds", "last_success")
)
# "modbus_client_requests" is the metric of outcomes.
CLIENT["requests"] = CLIENT["requests"]._replace(name="modbus_client_requests_sent")
REQUESTS = Family(
    "modbus_client_requests", "counter", "Outcomes of requests; each repetition counts."
)
DURATION = Family(
    "modbus_client_request_duration_seconds", "histogram", "Response times, in seconds."
)
LAST_SUCCESS = Family(
    "modbus_client_last_success_timestamp_seconds", "gauge", "Time of the last response.", max
)
SERVER = _counters("modbus_server", ServerStatistics, ("certificate_ends",), ("connections",))
CERTIFICATE = Family(
    "modbus_server_certificate_end_timestamp_seconds",
    "gauge",
    "Time at which the certificate of an endpoint expires.",
    min,
)
GATEWAY = _counters("modbus_gateway", GatewayStatistics, ("lines",))
LINE = _counters(
    "modbus_gateway_line",
    LineStatistics,
    ("url", "connection", "units", "trouble", "since"),
    ("waiting", "in_flight"),
)
UNIT = _counters("modbus_gateway_unit", UnitStatistics, gauges=("is_silent",))
FLEET = _counters(
    "modbus_fleet",
    FleetStatistics,
    ("lateness", "late_seconds", "outputs", "journal", "worst"),
    ("devices", "up", "down"),
)
LATENESS = Family(
    "modbus_fleet_lateness_seconds", "histogram", "Seconds by which polls began late."
)
OUTPUT = _counters("modbus_fleet_output", OutputStatistics, ("buffer", "trouble", "trouble_since"))
OUTPUT["dropped"] = Family(
    "modbus_fleet_output_dropped",
    "counter",
    "Readings dropped because too many waited, or because they could never be written.",
)
OUTPUT["waiting"] = Family(
    "modbus_fleet_output_waiting", "gauge", "Readings that wait for the output."
)
JOURNAL = _counters("modbus_fleet_journal", JournalStatistics, ("trouble",), ("bytes",))
VALUE = Family("modbus_fleet_value", "gauge", "The last value of a point.", max)


def _attributes(families: dict[str, Family], statistics: Any, labels: Labels) -> Values:
    for name, family in families.items():
        suffix = "" if family.type == "gauge" else "_total"
        yield Sample(family, suffix, labels), getattr(statistics, name)


def _of_server(statistics: ServerStatistics, labels: Labels) -> Values:
    yield from _attributes(SERVER, statistics, labels)
    for endpoint, end in statistics.certificate_ends.copy().items():
        yield Sample(CERTIFICATE, "", (*labels, ("endpoint", endpoint))), end


def _of_client(statistics: Statistics, labels: Labels) -> Values:
    yield from _attributes(CLIENT, statistics, labels)
    # Copies, because another thread may count at the same time.
    for (function, result), count in statistics.results.copy().items():
        outcome = (("function", str(function)), ("result", result))
        yield Sample(REQUESTS, "_total", labels + outcome), count
    times, seconds = statistics.answer_times, statistics.answer_seconds
    yield from _histogram(DURATION, TIME_BOUNDS, times, seconds, labels)
    if (last := statistics.last_success) is not None:
        yield Sample(LAST_SUCCESS, "", labels), time.time() - (time.monotonic() - last)


def _histogram(
    family: Family, bounds: Iterable[float], counts: list[int], seconds: float, labels: Labels
) -> Values:
    sums = list(accumulate(counts.copy()))
    for bound, below in zip([*map(str, bounds), "+Inf"], sums, strict=True):
        yield Sample(family, "_bucket", (*labels, ("le", bound))), below
    yield Sample(family, "_count", labels), sums[-1]
    yield Sample(family, "_sum", labels), seconds


def _of_fleet(statistics: FleetStatistics, labels: Labels) -> Values:
    yield from _attributes(FLEET, statistics, labels)
    lateness, seconds = statistics.lateness, statistics.late_seconds
    yield from _histogram(LATENESS, LATENESS_BOUNDS, lateness, seconds, labels)
    for name, output in statistics.outputs.copy().items():
        yield from _attributes(OUTPUT, output, (*labels, ("output", name)))
    if statistics.journal is not None:
        yield from _attributes(JOURNAL, statistics.journal, labels)


def _of_readings(kept: KeptReadings, labels: Labels) -> Values:
    for each in kept.by_name.copy().values():
        if isinstance(each.value, int | float):
            own = {label_name(key): value for key, value in each.labels.items()}
            own |= {"device": each.device, "name": each.name, "unit": each.unit}
            yield Sample(VALUE, "", (*labels, *own.items())), float(each.value)


def _of_gateway(statistics: GatewayStatistics, labels: Labels) -> Values:
    yield from _attributes(GATEWAY, statistics, labels)
    for url, line in statistics.lines.copy().items():
        place = url.partition("?")[0]
        of_line = (*labels, ("line", place))
        yield from _attributes(LINE, line, of_line)
        yield from _of_client(line.connection, (*labels, ("endpoint", place)))
        for number, unit in line.units.copy().items():
            yield from _attributes(UNIT, unit, (*of_line, ("unit", str(number))))


KINDS: dict[type, MetricKind] = {
    Statistics: MetricKind([REQUESTS, DURATION, LAST_SUCCESS, *CLIENT.values()], _of_client),
    ServerStatistics: MetricKind([*SERVER.values(), CERTIFICATE], _of_server, "server"),
    GatewayStatistics: MetricKind(
        [*GATEWAY.values(), *LINE.values(), *UNIT.values()], _of_gateway, "server"
    ),
    FleetStatistics: MetricKind(
        [*FLEET.values(), *OUTPUT.values(), *JOURNAL.values(), LATENESS], _of_fleet, "fleet"
    ),
    KeptReadings: MetricKind([VALUE], _of_readings),
}
"""The metrics of each class of statistics."""


# --- the collector --------------------------------------------------------------------------


class _Watched:
    """A weak reference to statistics, and their values when last read."""

    def __init__(self, statistics: Any, labels: Labels) -> None:
        self.statistics = weakref.ref(statistics)
        self.labels = labels
        self.values: dict[Sample, float] = {}

    def look(self) -> None:
        """Read the values. Those of statistics that were deleted do not change any more."""
        statistics = self.statistics()
        if statistics is not None:
            self.values = dict(KINDS[type(statistics)].read(statistics, self.labels))


def _labels_for(counted: Any, statistics: Any, name: str) -> Labels:
    """Return the labels of all values of an object."""
    if isinstance(statistics, Statistics):
        return (("endpoint", counted.url.partition("?")[0]),)  # without settings of a serial port
    label = KINDS[type(statistics)].label
    return ((label, name),) if label and name else ()


class Collector(_Collector):
    """
    Provides the metrics of clients, servers, gateways and fleets to a registry. Thread-safe.

    Objects are referenced weakly, so that the metrics of deleted objects disappear. Counts of
    objects with the same labels, such as clients of one endpoint or servers of one name, are added
    up. The counts of a deleted object remain while another object has the same labels, because a
    counter must not decrease.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._watched: list[_Watched] = []
        self._past: dict[Labels, dict[Sample, float]] = {}

    def add(self, *objects: Counted, name: str = "") -> None:
        """
        Add objects to the metrics. Adding one again has no effect.

        Args:
            objects: clients, servers, gateways, fleets, and `LastValues` of fleets. Handles of
                a client (`for_unit`) count as that client.
            name: the value of the label ``server`` of servers and gateways, or ``fleet`` of fleets;
                empty for no such label.

        Raises:
            TypeError: an object has another class.
        """
        found = [
            (each, statistics)
            for each in objects
            for statistics in (getattr(each, "statistics", None), getattr(each, "traffic", None))
            if statistics is not None or not hasattr(each, "statistics")
        ]
        for each, statistics in found:
            if type(statistics) not in KINDS:
                given = type(each).__name__
                raise TypeError(
                    f"objects must be clients, servers, gateways, fleets or LastValues, not {given}"
                )
        with self._lock:
            for each, statistics in found:
                if all(other.statistics() is not statistics for other in self._watched):
                    labels = _labels_for(each, statistics, name)
                    self._watched.append(_Watched(statistics, labels))
            self._forget_gone()  # here, too, because the metrics may never be scraped

    def describe(self) -> Iterator[Metric]:
        """Yield all possible metrics without values, so that a registry knows their names."""
        for kind in KINDS.values():
            for family in kind.families:
                yield Metric(family.name, family.text, family.type)

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics with their current values, for a registry."""
        with self._lock:
            values = self._values()
        metrics: dict[Family, Metric] = {}
        for (family, suffix, labels), value in values.items():
            if family not in metrics:
                metrics[family] = Metric(family.name, family.text, family.type)
            metrics[family].add_sample(family.name + suffix, dict(labels), value)
        yield from metrics.values()

    def _values(self) -> dict[Sample, float]:
        for each in self._watched:
            each.look()
        self._forget_gone()
        values: dict[Sample, float] = {}
        for some in [*self._past.values(), *(each.values for each in self._watched)]:
            _add(values, some)
        return values

    def _forget_gone(self) -> None:
        """Keep the counts of deleted objects as long as others have their labels."""
        gone = [each for each in self._watched if each.statistics() is None]
        self._watched = [each for each in self._watched if each not in gone]
        present = {each.labels for each in self._watched}
        for each in gone:
            staying = {key: at for key, at in each.values.items() if key.family.type != "gauge"}
            _add(self._past.setdefault(each.labels, {}), staying)
        self._past = {labels: past for labels, past in self._past.items() if labels in present}


def _add(values: dict[Sample, float], more: dict[Sample, float]) -> None:
    for sample, value in more.items():
        known = values.get(sample)
        values[sample] = value if known is None else sample.family.together(known, value)


_collectors: weakref.WeakKeyDictionary[CollectorRegistry, Collector] = weakref.WeakKeyDictionary()
_collectors_lock = threading.Lock()


def collect(*objects: Counted, name: str = "", registry: CollectorRegistry = REGISTRY) -> Collector:
    """
    Add clients, servers, gateways and fleets to the metrics of a registry.

    Args:
        objects, name: as for `Collector.add`.
        registry: the registry; by default that of prometheus_client. Each registry has one
            collector, which the first call registers.

    Returns:
        The collector of the registry.

    Raises:
        TypeError: an object has another class.
        ValueError: another collector of the registry has metrics of the same names.
    """
    with _collectors_lock:
        collector = _collectors.get(registry)
        if collector is None:
            collector = Collector()
            registry.register(collector)
            _collectors[registry] = collector
    collector.add(*objects, name=name)
    return collector


@contextlib.contextmanager
def exposing(host: str, port: int, registry: CollectorRegistry = REGISTRY) -> Iterator[str]:
    """
    Serve the metrics of a registry over HTTP while the ``with`` block runs.

    Args:
        host: the address to listen on.
        port: the port to listen on; 0 for any free port.
        registry: the registry whose metrics are served.

    Returns:
        A context manager, whose value is the URL of the metrics with the port.

    Raises:
        OSError: the address or the port cannot be used.
    """
    server = TimedServer(host, port, MetricsHandler.factory(registry), LIMIT_S)
    with server.serving("metrics"):
        yield f"{server.place}/metrics"
