"""
The statistics of clients, servers, gateways and fleets as metrics of Prometheus.

Statistics are read when the metrics are scraped; requests do not become slower. Each attribute of
a class of statistics is a metric, whose help text is the description in the docstring of the class:
``modbus_client_...``, ``modbus_server_...``, ``modbus_gateway_...`` (its lines with the label
``line``, and their units with ``line`` and ``unit``), and ``modbus_fleet_...`` (its outputs with
the label ``output``). Metrics that are no such attributes are written out below.
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

LIMIT_S = 3.0
"""Seconds that an HTTP request for metrics and its response may take."""

Labels = tuple[tuple[str, str], ...]


class Counted(Protocol):
    """A client, a server, a gateway or a fleet; a gateway also has `traffic`."""

    @property
    def statistics(self) -> Any: ...


class Family(NamedTuple):
    """A metric; `together` combines the values of two objects with the same labels."""

    name: str
    type: str
    text: str
    together: Callable[[float, float], float] = add


class Sample(NamedTuple):
    """One value of a metric; values of equal samples are combined."""

    family: Family
    suffix: str
    labels: Labels


Values = Iterable[tuple[Sample, float]]


# --- the metrics ---------------------------------------------------------------------------


def _texts(kind: type) -> dict[str, str]:
    """Return the descriptions of attributes in the docstring of a class."""
    section = re.split(r"\nAttributes:\n", inspect.getdoc(kind) or "")[-1]
    found = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", section, re.MULTILINE)
    return {name: text[0].upper() + re.sub(r"\s+", " ", text[1:]) for name, text in found}


GAUGES = {
    *("bytes", "connections", "devices", "down", "in_flight", "is_silent", "up", "waiting"),
}
"""Attributes that may decrease; the other ones are counters."""


def _counters(prefix: str, kind: type, *more: str) -> dict[str, Family]:
    """Return the metrics of the whole numbers of a class and of further attributes, by name."""
    texts, found = _texts(kind), {}
    numbers = [each.name for each in fields(kind) if each.type in ("int", "bool")]
    for name in [*numbers, *more]:
        text = texts.get(name) or inspect.getdoc(getattr(kind, name)) or name
        found[name] = Family(f"{prefix}_{name}", "gauge" if name in GAUGES else "counter", text)
    return found


COUNTERS: dict[type, dict[str, Family]] = {
    Statistics: _counters("modbus_client", Statistics),
    ServerStatistics: _counters("modbus_server", ServerStatistics),
    GatewayStatistics: _counters("modbus_gateway", GatewayStatistics),
    LineStatistics: _counters("modbus_gateway_line", LineStatistics),
    UnitStatistics: _counters("modbus_gateway_unit", UnitStatistics, "seconds"),
    FleetStatistics: _counters("modbus_fleet", FleetStatistics),
    OutputStatistics: _counters("modbus_fleet_output", OutputStatistics, "dropped", "waiting"),
    JournalStatistics: _counters("modbus_fleet_journal", JournalStatistics),
}
# "modbus_client_requests" is the metric of outcomes.
SENT = COUNTERS[Statistics]["requests"]._replace(name="modbus_client_requests_sent")
COUNTERS[Statistics]["requests"] = SENT

REQUESTS = Family(
    "modbus_client_requests", "counter", "Outcomes of requests; each repetition counts."
)
DURATION = Family(
    "modbus_client_request_duration_seconds", "histogram", "Response times, in seconds."
)
LAST_SUCCESS = Family(
    "modbus_client_last_success_timestamp_seconds", "gauge", "Time of the last response.", max
)
CERTIFICATE = Family(
    "modbus_server_certificate_end_timestamp_seconds",
    "gauge",
    "Time at which the certificate of an endpoint expires.",
    min,
)
LATENESS = Family(
    "modbus_fleet_lateness_seconds", "histogram", "Seconds by which polls began late."
)
VALUE = Family("modbus_fleet_value", "gauge", "The last value of a point.", max)

FAMILIES: list[Family] = [REQUESTS, DURATION, LAST_SUCCESS, CERTIFICATE, LATENESS, VALUE]
FAMILIES += [family for found in COUNTERS.values() for family in found.values()]


def _counted(statistics: Any, labels: Labels) -> Values:
    for name, family in COUNTERS[type(statistics)].items():
        suffix = "" if family.type == "gauge" else "_total"
        yield Sample(family, suffix, labels), getattr(statistics, name)


def _histogram(
    family: Family, bounds: Iterable[float], counts: list[int], seconds: float, labels: Labels
) -> Values:
    sums = list(accumulate(counts.copy()))
    for bound, below in zip([*map(str, bounds), "+Inf"], sums, strict=True):
        yield Sample(family, "_bucket", (*labels, ("le", bound))), below
    yield Sample(family, "_count", labels), sums[-1]
    yield Sample(family, "_sum", labels), seconds


# Dictionaries are copied, because another thread may count at the same time.


def _of_server(statistics: ServerStatistics, labels: Labels) -> Values:
    yield from _counted(statistics, labels)
    for endpoint, end in statistics.certificate_ends.copy().items():
        yield Sample(CERTIFICATE, "", (*labels, ("endpoint", endpoint))), end


def _of_client(statistics: Statistics, labels: Labels) -> Values:
    yield from _counted(statistics, labels)
    for (function, result), count in statistics.results.copy().items():
        outcome = (("function", str(function)), ("result", result))
        yield Sample(REQUESTS, "_total", labels + outcome), count
    times, seconds = statistics.answer_times, statistics.answer_seconds
    yield from _histogram(DURATION, TIME_BOUNDS, times, seconds, labels)
    if (last := statistics.last_success) is not None:
        yield Sample(LAST_SUCCESS, "", labels), time.time() - (time.monotonic() - last)


def _of_fleet(statistics: FleetStatistics, labels: Labels) -> Values:
    yield from _counted(statistics, labels)
    lateness, seconds = statistics.lateness, statistics.late_seconds
    yield from _histogram(LATENESS, LATENESS_BOUNDS, lateness, seconds, labels)
    for name, output in statistics.outputs.copy().items():
        yield from _counted(output, (*labels, ("output", name)))
    if statistics.journal is not None:
        yield from _counted(statistics.journal, labels)


def _of_readings(kept: KeptReadings, labels: Labels) -> Values:
    for each in kept.by_name.copy().values():
        if isinstance(each.value, int | float):
            own = {label_name(key): value for key, value in each.labels.items()}
            own |= {"device": each.device, "name": each.name, "unit": each.unit}
            yield Sample(VALUE, "", (*labels, *own.items())), float(each.value)


def _of_gateway(statistics: GatewayStatistics, labels: Labels) -> Values:
    yield from _counted(statistics, labels)
    for url, line in statistics.lines.copy().items():
        place = url.partition("?")[0]
        of_line = (*labels, ("line", place))
        yield from _counted(line, of_line)
        yield from _of_client(line.connection, (*labels, ("endpoint", place)))
        for number, unit in line.units.copy().items():
            yield from _counted(unit, (*of_line, ("unit", str(number))))


KINDS: dict[type, tuple[Callable[[Any, Labels], Values], str]] = {
    Statistics: (_of_client, ""),
    ServerStatistics: (_of_server, "server"),
    GatewayStatistics: (_of_gateway, "server"),
    FleetStatistics: (_of_fleet, "fleet"),
    KeptReadings: (_of_readings, ""),
}
"""Class of statistics -> returns their values with given labels; the label of a given name."""


# --- the collector --------------------------------------------------------------------------


class _Watched:
    """A weak reference to statistics, and their values when last read."""

    def __init__(self, statistics: Any, labels: Labels) -> None:
        self.statistics = weakref.ref(statistics)
        self.labels = labels
        self.values: dict[Sample, float] = {}


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
        found: list[tuple[Any, Labels]] = []
        for each in objects:
            for statistics in filter(None, (_statistics(each), getattr(each, "traffic", None))):
                _, label = KINDS[type(statistics)]
                labels: Labels = ((label, name),) if label and name else ()
                if isinstance(statistics, Statistics):
                    # Without settings, such as those of a serial port.
                    labels = (("endpoint", each.url.partition("?")[0]),)  # type: ignore[attr-defined]
                found.append((statistics, labels))
        with self._lock:
            for statistics, labels in found:
                if all(other.statistics() is not statistics for other in self._watched):
                    self._watched.append(_Watched(statistics, labels))
            self._forget_gone()  # here, too, because the metrics may never be scraped

    def describe(self) -> Iterator[Metric]:
        """Yield all possible metrics without values, so that a registry knows their names."""
        return (Metric(family.name, family.text, family.type) for family in FAMILIES)

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
            if (statistics := each.statistics()) is not None:
                read, _ = KINDS[type(statistics)]
                each.values = dict(read(statistics, each.labels))
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


def _statistics(counted: object) -> Any:
    found = getattr(counted, "statistics", None)
    if type(found) not in KINDS:
        given = type(counted).__name__
        raise TypeError(
            f"objects must be clients, servers, gateways, fleets or LastValues, not {given}"
        )
    return found


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
    """Serve the metrics of a registry over HTTP while the block runs; the value is their URL."""
    server = TimedServer(host, port, MetricsHandler.factory(registry), LIMIT_S)
    with server.serving("metrics"):
        yield f"{server.place}/metrics"
