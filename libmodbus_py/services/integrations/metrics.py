"""
The metrics of Prometheus: their names, types and help texts, and how they are read from statistics.

Requests do not become slower: statistics are read when metrics are scraped. There may be hundreds
of thousands of values of points, so that metrics of devices are made one by one while they are
written; all others are a few for each client, server, line and output.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import accumulate
from operator import add
from typing import Any, Literal, NamedTuple

from ...client.statistics import TIME_BOUNDS, Statistics
from ...server.limits import ServerStatistics
from ..fleet.config import label_name
from ..fleet.poller import DeviceState, Poller
from ..fleet.readings import reason_of
from ..fleet.statistics import LATENESS_BOUNDS, FleetStatistics, JournalStatistics, OutputStatistics
from ..gateway.statistics import GatewayStatistics, LineStatistics, UnitStatistics

Labels = tuple[tuple[str, str], ...]

Type = Literal["counter", "gauge", "histogram"]


class Family(NamedTuple):
    """A metric; `together` combines the values of two objects with the same labels."""

    name: str
    type: Type
    text: str
    together: Callable[[float, float], float] = add


class Sample(NamedTuple):
    """One value of a metric; values of equal samples are combined."""

    family: Family
    suffix: str
    labels: Labels


Values = Iterator[tuple[Sample, float]]

COUNTER: Type = "counter"
GAUGE: Type = "gauge"

Row = tuple[str, Type, str]


def _attributes(prefix: str, *rows: Row) -> dict[str, Family]:
    """Return metrics by the attributes that they are read from, and that they are named after."""
    return {name: Family(f"{prefix}_{name}", kind, text) for name, kind, text in rows}


VETOES = Family("modbus_fleet_held", COUNTER, "Polls not sent because may_ask did not allow them.")
"""Not named after its attribute, because dashboards know it by this name."""

OF_ATTRIBUTES: dict[type, dict[str, Family]] = {
    Statistics: {
        # "modbus_client_requests" is the metric of outcomes.
        "requests": Family(
            "modbus_client_requests_sent", COUNTER, "Requests that were sent, repetitions included."
        ),
        **_attributes(
            "modbus_client",
            ("responses", COUNTER, "Valid responses, exception responses included."),
            ("exceptions", COUNTER, "Exception responses."),
            ("timeouts", COUNTER, "Requests that got no response in time."),
            ("retries", COUNTER, "Requests that were sent again."),
            ("echoes", COUNTER, "1 if the connection returns what is sent on it (local echo)."),
            ("late_answers", COUNTER, "Dropped responses to requests that had been given up."),
            ("invalid", COUNTER, "Bytes that were no frame, and frames that were no response."),
            ("connects", COUNTER, "Connections that were established."),
            ("failed_connects", COUNTER, "Attempts to connect that failed."),
            ("lost", COUNTER, "Connections that ended by themselves or were given up."),
        ),
    },
    ServerStatistics: _attributes(
        "modbus_server",
        ("connections", GAUGE, "TCP connections that are open now."),
        ("accepted", COUNTER, "TCP connections that were accepted."),
        ("disallowed", COUNTER, "Connections and datagrams from networks that are not served."),
        ("refused_full", COUNTER, "Connections closed at once: there were too many."),
        ("refused_address", COUNTER, "Connections closed at once: their address had too many."),
        ("closed_for_others", COUNTER, "Idle connections closed to make room for others."),
        ("closed_idle", COUNTER, "Connections closed after idle_timeout."),
        ("closed_slow", COUNTER, "Connections closed: a frame or a handshake took too long."),
        ("closed_out_of_step", COUNTER, "Connections closed because of an invalid header."),
        ("closed_untrusted", COUNTER, "Connections closed: their certificate is not valid now."),
        ("paused", COUNTER, "How often a client was not read: it did not take its responses."),
        ("throttled", COUNTER, "How often a client exceeded requests_per_second."),
        ("reflected", COUNTER, "Datagrams not answered: they were responses that came back."),
        ("echoes", COUNTER, "Lines that return what is sent on them (local echo)."),
        ("requests", COUNTER, "Frames that were received, those for other units included."),
        ("refused", COUNTER, "Requests that got an exception response."),
        ("unauthorized", COUNTER, "Requests that authorize of a device did not allow."),
        ("bad_frames", COUNTER, "Runs of bytes that were no frame."),
        ("handshakes", COUNTER, "TLS connections on which both sides accepted the other."),
        ("handshakes_resumed", COUNTER, "TLS connections that resumed a session."),
        ("handshakes_refused", COUNTER, "TLS connections refused, or without TLS."),
    ),
    GatewayStatistics: _attributes(
        "modbus_gateway",
        ("requests", COUNTER, "Requests received from clients."),
        ("no_route", COUNTER, "Requests refused because there is no route for their unit."),
        ("refused", COUNTER, "Requests not allowed by a route or by authorize."),
        ("malformed", COUNTER, "Requests with an invalid function code or a wrong length."),
        ("broadcasts", COUNTER, "Writes to unit 0, sent to all lines."),
    ),
    LineStatistics: _attributes(
        "modbus_gateway_line",
        ("is_down", GAUGE, "1 if there is no connection, although one was wanted."),
        ("waiting", GAUGE, "Requests in the queue now."),
        ("in_flight", GAUGE, "Requests that wait for their response now."),
        ("full", COUNTER, "Requests refused with exception 6: the queue was full, or slow."),
        ("unwanted", COUNTER, "Responses dropped because the client did not wait any more."),
    ),
    UnitStatistics: _attributes(
        "modbus_gateway_unit",
        ("requests", COUNTER, "Requests sent to the unit."),
        ("answers", COUNTER, "Valid responses of the unit, exceptions included."),
        ("exceptions", COUNTER, "Exception responses of the unit."),
        ("timeouts", COUNTER, "Requests without a response in time."),
        ("invalid", COUNTER, "Requests with an invalid response."),
        ("lost", COUNTER, "Requests without a connection, or whose connection was lost."),
        ("refused", COUNTER, "Requests answered with exception 11 at once: the unit was silent."),
        ("given_up", COUNTER, "Trials of a silent unit ended because other requests waited."),
        ("cached", COUNTER, "Requests answered from the cache."),
        ("merged", COUNTER, "Requests answered with the response to an equal request."),
        ("is_silent", GAUGE, "1 if the unit is paused, because it answers nothing."),
        ("seconds", COUNTER, "Total response time, in seconds."),
    ),
    FleetStatistics: _attributes(
        "modbus_fleet",
        ("devices", GAUGE, "Devices in the fleet now."),
        ("up", GAUGE, "Devices that answered their last poll."),
        ("down", GAUGE, "Devices that did not answer their last poll."),
        ("polls", COUNTER, "Completed polls, failed ones included."),
        ("failures", COUNTER, "Polls without an answer."),
        ("refusals", COUNTER, "Polls in which a device refused a request."),
        ("skipped", COUNTER, "Polls skipped: the previous one of the device was under way."),
        ("readings", COUNTER, "Readings passed to outputs."),
        ("commands", COUNTER, "Writes carried out for outputs."),
        ("refused_commands", COUNTER, "Writes refused or failed."),
    )
    | {"vetoes": VETOES},
    OutputStatistics: _attributes(
        "modbus_fleet_output",
        ("is_failing", GAUGE, "1 if the output cannot be opened or written to."),
        ("is_behind", GAUGE, "1 if more than one batch has waited for 10 s."),
        ("waiting", GAUGE, "Readings that wait for the output."),
        ("written", COUNTER, "Readings written to the output."),
        ("failures", COUNTER, "Failed attempts to open the output or to write to it."),
        ("dropped", COUNTER, "Readings dropped: too many waited, or they cannot be written."),
    ),
    JournalStatistics: _attributes(
        "modbus_fleet_journal",
        ("is_failing", GAUGE, "1 if the journal cannot be written or read."),
        ("bytes", GAUGE, "The size of the journal on the disk."),
        ("written", COUNTER, "Readings written to the journal."),
        ("dropped", COUNTER, "Readings that the journal lacks: the disk took none for too long."),
        ("failures", COUNTER, "Failed attempts to write to the journal, or to read it."),
    ),
}
"""Class of statistics -> the metrics that are its attributes."""

REQUESTS = Family(
    "modbus_client_requests", COUNTER, "Outcomes of requests; each repetition counts."
)
DURATION = Family(
    "modbus_client_request_duration_seconds", "histogram", "Response times, in seconds."
)
LAST_SUCCESS = Family(
    "modbus_client_last_success_timestamp_seconds", GAUGE, "Time of the last response.", max
)
CERTIFICATE = Family(
    "modbus_server_certificate_end_timestamp_seconds",
    GAUGE,
    "Time at which the certificate of an endpoint expires.",
    min,
)
LATENESS = Family("modbus_fleet_lateness_seconds", "histogram", "Seconds by which polls were late.")
DEVICE_UP = Family("modbus_fleet_device_up", GAUGE, "1 if the device answered its last poll.")
DEVICE_DOWN = Family("modbus_fleet_device_down", GAUGE, "1 for a device that is down, with why.")
BAD_POINT = Family("modbus_fleet_bad_point", GAUGE, "1 for a point without a good value, with why.")
VALUE = Family("modbus_fleet_value", GAUGE, "The last value of a point.")

OF_DEVICES = (DEVICE_UP, DEVICE_DOWN, BAD_POINT, VALUE)
"""Metrics of each device; see `values_of_devices`."""

FAMILIES: list[Family] = [REQUESTS, DURATION, LAST_SUCCESS, CERTIFICATE, LATENESS, *OF_DEVICES]
FAMILIES += [family for of_class in OF_ATTRIBUTES.values() for family in of_class.values()]


def _of_attributes(statistics: Any, labels: Labels) -> Values:
    for name, family in OF_ATTRIBUTES[type(statistics)].items():
        suffix = "_total" if family.type == COUNTER else ""
        yield Sample(family, suffix, labels), getattr(statistics, name)


def _of_histogram(
    family: Family, bounds: Iterable[float], counts: list[int], seconds: float, labels: Labels
) -> Values:
    sums = list(accumulate(counts.copy()))
    for bound, below in zip([*map(str, bounds), "+Inf"], sums, strict=True):
        yield Sample(family, "_bucket", (*labels, ("le", bound))), below
    yield Sample(family, "_count", labels), sums[-1]
    yield Sample(family, "_sum", labels), seconds


# Dictionaries are copied, because another thread may count at the same time.


def _of_server(statistics: ServerStatistics, labels: Labels) -> Values:
    yield from _of_attributes(statistics, labels)
    for endpoint, end in statistics.certificate_ends.copy().items():
        yield Sample(CERTIFICATE, "", (*labels, ("endpoint", endpoint))), end


def _of_client(statistics: Statistics, labels: Labels) -> Values:
    yield from _of_attributes(statistics, labels)
    for (function, result), count in statistics.results.items():
        outcome = (("function", str(function)), ("result", result))
        yield Sample(REQUESTS, "_total", labels + outcome), count
    times, seconds = statistics.answer_times, statistics.answer_seconds
    yield from _of_histogram(DURATION, TIME_BOUNDS, times, seconds, labels)
    if (last := statistics.last_success) is not None:
        yield Sample(LAST_SUCCESS, "", labels), time.time() - (time.monotonic() - last)


def _of_fleet(statistics: FleetStatistics, labels: Labels) -> Values:
    yield from _of_attributes(statistics, labels)
    lateness, seconds = statistics.lateness, statistics.late_seconds
    yield from _of_histogram(LATENESS, LATENESS_BOUNDS, lateness, seconds, labels)
    for name, output in statistics.outputs.copy().items():
        yield from _of_attributes(output, (*labels, ("output", name)))
    if statistics.journal is not None:
        yield from _of_attributes(statistics.journal, labels)


def _of_gateway(statistics: GatewayStatistics, labels: Labels) -> Values:
    yield from _of_attributes(statistics, labels)
    for url, line in statistics.lines.copy().items():
        place = url.partition("?")[0]
        of_line = (*labels, ("line", place))
        yield from _of_attributes(line, of_line)
        yield from _of_client(line.connection, (*labels, ("endpoint", place)))
        for number, unit in line.units.copy().items():
            yield from _of_attributes(unit, (*of_line, ("unit", str(number))))


READERS: dict[type, tuple[Callable[[Any, Labels], Values], str]] = {
    Statistics: (_of_client, ""),
    ServerStatistics: (_of_server, "server"),
    GatewayStatistics: (_of_gateway, "server"),
    FleetStatistics: (_of_fleet, "fleet"),
}
"""Class of statistics -> returns their values with given labels; the label of a given name."""


# --- devices and their points -----------------------------------------------------------------

NOT_POLLED = "NotPolledYet"
"""The reason of a device without a poll that is over."""

Dictionary = dict[str, str]


def values_of_devices(
    family: Family, devices: Mapping[str, Poller], labels: Labels
) -> Iterator[tuple[Dictionary, float]]:
    """Yield labels and value of each sample of one of `OF_DEVICES`."""
    read = _READ[family]
    for name, poller in devices.items():
        own = {label_name(key): value for key, value in poller.config.labels.items()}
        yield from read(poller, {**own, **dict(labels), "device": name})


def _up(poller: Poller, labels: Dictionary) -> Iterator[tuple[Dictionary, float]]:
    yield labels, poller.state is DeviceState.UP


def _down(poller: Poller, labels: Dictionary) -> Iterator[tuple[Dictionary, float]]:
    error = poller.error
    if poller.state is not DeviceState.UP:
        yield labels | {"reason": NOT_POLLED if error is None else reason_of(error)}, 1


def _bad_points(poller: Poller, labels: Dictionary) -> Iterator[tuple[Dictionary, float]]:
    for name, reason in poller.bad_points.items():
        yield labels | {"name": name, "reason": reason}, 1


def _values(poller: Poller, labels: Dictionary) -> Iterator[tuple[Dictionary, float]]:
    for point in poller.last_values():
        if isinstance(point.value, int | float):
            yield labels | {"name": point.name, "unit": point.units}, float(point.value)


_READ = {DEVICE_UP: _up, DEVICE_DOWN: _down, BAD_POINT: _bad_points, VALUE: _values}
