"""The statistics of clients, servers, gateways and fleets as metrics of Prometheus."""

from __future__ import annotations

import contextlib
import io
import threading
import time
import weakref
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol, cast

from ...client.statistics import Statistics
from ...tools.timed_server import TimedServer
from ...version import what_is_missing
from ..fleet.fleet import Fleet
from ..fleet.poller import Poller
from .metrics import FAMILIES, OF_DEVICES, READERS, Family, Labels, Sample, values_of_devices

try:
    from prometheus_client import REGISTRY, CollectorRegistry, MetricsHandler
    from prometheus_client.core import Metric
    from prometheus_client.core import Sample as Line
    from prometheus_client.registry import Collector as _Collector
except ImportError as error:
    raise ImportError(what_is_missing("the exporter", "metrics")) from error

LIMIT_S = 10.0
"""Seconds for the request of a client, and for taking the answer: Prometheus waits as long."""


class StatisticsSource(Protocol):
    """A client, a server, a gateway or a fleet; a gateway also has `traffic`."""

    @property
    def statistics(self) -> Any: ...


class _Watched:
    """A weak reference to statistics, and their values when last read."""

    def __init__(self, statistics: Any, labels: Labels) -> None:
        self.statistics = weakref.ref(statistics)
        self.labels = labels
        self.values: dict[Sample, float] = {}


class _WatchedFleet(NamedTuple):
    fleet: weakref.ref[Fleet]
    labels: Labels


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
        self._fleets: list[_WatchedFleet] = []
        self._past: dict[Labels, dict[Sample, float]] = {}

    def add(self, *objects: StatisticsSource, name: str = "") -> None:
        """
        Add objects to the metrics. Adding one again has no effect.

        Args:
            objects: clients, servers, gateways and fleets. Handles of a client (`for_unit`) count
                as that client.
            name: the value of the label ``server`` of servers and gateways, or ``fleet`` of fleets;
                empty for no such label.

        Raises:
            TypeError: an object has another class.
        """
        entries: list[_Watched] = []
        fleets: list[_WatchedFleet] = []
        for source in objects:
            for statistics in filter(None, (_statistics(source), getattr(source, "traffic", None))):
                _, label = READERS[type(statistics)]
                labels: Labels = ((label, name),) if label and name else ()
                if isinstance(statistics, Statistics):
                    # Without settings, such as those of a serial port.
                    labels = (("endpoint", source.url.partition("?")[0]),)  # type: ignore[attr-defined]
                entries.append(_Watched(statistics, labels))
                if isinstance(source, Fleet):
                    fleets.append(_WatchedFleet(weakref.ref(source), labels))
        with self._lock:
            for one in entries:
                if all(other.statistics() is not one.statistics() for other in self._watched):
                    self._watched.append(one)
            for fleet in fleets:
                if all(other.fleet is not fleet.fleet for other in self._fleets):
                    self._fleets.append(fleet)
            self._forget_gone()  # not only in scrapes, of which there may be none

    def describe(self) -> Iterator[Metric]:
        """Yield all possible metrics without values, so that a registry knows their names."""
        return map(_metric, FAMILIES)

    def collect(self) -> Iterator[Metric]:
        """
        Yield the metrics with their current values, for a registry.

        The samples of devices are made while they are iterated over: there may be very many.
        """
        with self._lock:
            values = self._values()
            fleets = [(fleet, labels) for ref, labels in self._fleets if (fleet := ref())]
        metrics: dict[Family, Metric] = {}
        for (family, suffix, labels), value in values.items():
            if family not in metrics:
                metrics[family] = _metric(family)
            metrics[family].add_sample(family.name + suffix, dict(labels), value)
        yield from metrics.values()
        devices: dict[Labels, dict[str, Poller]] = {}
        for fleet, labels in fleets:  # of two devices with the same labels, one is shown
            devices.setdefault(labels, {}).update(fleet.devices)
        for family in OF_DEVICES if fleets else ():
            metric = _metric(family)
            metric.samples = cast(list[Line], _DeviceLines(family, devices))
            yield metric

    def _values(self) -> dict[Sample, float]:
        for source in self._watched:
            if (statistics := source.statistics()) is not None:
                read, _ = READERS[type(statistics)]
                source.values = dict(read(statistics, source.labels))
        self._forget_gone()
        values: dict[Sample, float] = {}
        for some in [*self._past.values(), *(source.values for source in self._watched)]:
            _add(values, some)
        return values

    def _forget_gone(self) -> None:
        """Keep the counts of deleted objects as long as others have their labels."""
        deleted_sources = [source for source in self._watched if source.statistics() is None]
        self._watched = [source for source in self._watched if source not in deleted_sources]
        self._fleets = [fleet for fleet in self._fleets if fleet.fleet() is not None]
        present = {source.labels for source in self._watched}
        for source in deleted_sources:
            staying = {key: at for key, at in source.values.items() if key.family.type != "gauge"}
            _add(self._past.setdefault(source.labels, {}), staying)
        self._past = {labels: past for labels, past in self._past.items() if labels in present}


class _DeviceLines:
    """The samples of a metric of devices; iterating over them makes them."""

    def __init__(self, family: Family, devices: Mapping[Labels, Mapping[str, Poller]]) -> None:
        self._family = family
        self._devices = devices

    def __iter__(self) -> Iterator[Line]:
        for labels, devices in self._devices.items():
            for own, value in values_of_devices(self._family, devices, labels):
                yield Line(self._family.name, own, value)


def _metric(family: Family) -> Metric:
    return Metric(family.name, family.text, family.type)


def _statistics(source: object) -> Any:
    statistics = getattr(source, "statistics", None)
    if type(statistics) not in READERS:
        kind = type(source).__name__
        raise TypeError(f"objects must be clients, servers, gateways or fleets, not {kind}")
    return statistics


def _add(values: dict[Sample, float], more: dict[Sample, float]) -> None:
    for sample, value in more.items():
        sum_so_far = values.get(sample)
        values[sample] = value if sum_so_far is None else sample.family.together(sum_so_far, value)


_collectors: weakref.WeakKeyDictionary[CollectorRegistry, Collector] = weakref.WeakKeyDictionary()
_collectors_lock = threading.Lock()


def collect(
    *objects: StatisticsSource, name: str = "", registry: CollectorRegistry = REGISTRY
) -> Collector:
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


# --- over HTTP ------------------------------------------------------------------------------

WORK_S = 0.001
"""Seconds of work on an answer, after which as many are left to the other threads."""

ONE_ANSWER = threading.Lock()
"""Answers are made one after the other: those of many clients would leave others no time."""


class _MetricsHandler(MetricsHandler):
    """Answers a request; the time of its own work is not that of the client."""

    server: TimedServer

    def do_GET(self) -> None:
        registry, client = self.registry, self.wfile
        answer = io.BytesIO()
        self.server.keep(self.connection)
        with ONE_ANSWER:
            self.registry = cast(CollectorRegistry, _PacedRegistry(registry, self.server))
            self.wfile = answer
            try:
                super().do_GET()
            finally:
                self.wfile = client
        self.server.keep(self.connection, LIMIT_S)
        client.write(answer.getbuffer())


class _PacedRegistry:
    """A registry whose samples come in pieces, until its server is closed."""

    def __init__(self, registry: _Collector, server: TimedServer) -> None:
        self._registry = registry
        self._server = server

    def restricted_registry(self, names: Iterable[str]) -> _PacedRegistry:
        registry = cast(CollectorRegistry, self._registry)
        return _PacedRegistry(registry.restricted_registry(names), self._server)

    def collect(self) -> Iterator[Metric]:
        for metric in self._registry.collect():
            metric.samples = cast(list[Line], self._paced(metric.samples))
            yield metric

    def _paced(self, samples: Iterable[Line]) -> Iterator[Line]:
        start = time.perf_counter()
        for sample in samples:
            yield sample
            if time.perf_counter() - start > WORK_S:
                if self._server.is_closed:
                    raise ConnectionAbortedError("the metrics are not served any more")
                time.sleep(WORK_S)
                start = time.perf_counter()


@contextlib.contextmanager
def exposing(host: str, port: int, registry: CollectorRegistry = REGISTRY) -> Iterator[str]:
    """Serve the metrics of a registry over HTTP while the block runs; the value is their URL."""
    server = TimedServer(host, port, _MetricsHandler.factory(registry), LIMIT_S)
    with server.serving("metrics"):
        yield f"{server.place}/metrics"
