"""Whoever watches a page without a browser: requests as bytes or by http.client, and its stream."""

from __future__ import annotations

import contextlib
import http.client
import json
import time
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import parse_qs, urlsplit

from libmodbus_py import Device, Mapping, Server, ServerDeviceBusy
from libmodbus_py.maps.point import Point
from libmodbus_py.page import live_page

POINTS = (
    Point("temperature", "holding_registers", 0, type="float32", order="CDAB", units="°C"),
    Point("level", "holding_registers", 2, scale=0.1, units="m", minimum=0, maximum=100),
    Point("label", "holding_registers", 3, type="string:8"),
    Point("limits", "holding_registers", 7, count=2, type="int16"),
    Point("pump", "coils", 0),
    Point("flow", "input_registers", 0, type="uint32"),
)
NAMES = ["temperature", "level", "label", "limits", "pump", "flow"]


class NamedDevice(Device):
    """As devices of device files have names."""

    name = "tank <script>alert(1)</script>"
    description = "a & b"
    points = {point.name: point for point in POINTS}  # noqa: RUF012


def make_server(**options: Any) -> Server:
    mapping = Mapping(
        coils=16,
        discrete_inputs=4,
        holding_registers=[range(20), range(100, 110)],
        input_registers=8,
    )
    mapping.holding_registers.write(0, 21.5, "float32", order="CDAB")
    mapping.holding_registers.write(3, "abc", "string:8")
    return Server({1: NamedDevice(mapping), 2: Device(Mapping(holding_registers=8))}, **options)


def is_served(ask: Callable[[], object]) -> bool:
    """Return False if a client is told that the device is busy."""
    try:
        ask()
    except ServerDeviceBusy:
        return False
    return True


class Visitor:
    """Asks as the page does, and sees the tables that messages of the stream brought."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self.host = parts.netloc
        self.address = (parts.hostname or "", parts.port or 0)
        self.token = parse_qs(parts.query)["token"][0]
        self.headers = {
            "Cookie": f"libmodbus_page_{self.address[1]}={self.token}",
            "Origin": f"http://{self.host}",
            "Content-Type": "application/json",
        }
        self.seen: dict[str, dict[str, Any]] = {}
        self.messages: list[dict[str, Any]] = []

    def rows(self, table: str) -> list[Any]:
        """Return the rows of a table, in the order of their keys if these are numbers."""
        rows = self.seen.get(table, {})
        keys = sorted(rows, key=int) if all(map(str.isdigit, rows)) else rows
        return [rows[key] for key in keys]

    def cells(self, table: str) -> dict[int, int]:
        """Return the cells that exist of a table of a unit, such as "1/coils", by address."""
        rows = self.seen.get(table, {}).items()
        cells = ((int(first) + at, cell) for first, row in rows for at, cell in enumerate(row))
        return {at: cell for at, cell in cells if cell is not None}

    def points(self, table: str) -> list[str]:
        """Return the texts of points of a unit."""
        return [row["text"] for row in self.rows(table)]

    def ask(
        self, method: str, path: str, body: Any = None, **headers: str | None
    ) -> tuple[int, dict[str, str], bytes]:
        """Return status, headers and body; a header that is None is left out."""
        fields = self.headers | {name.replace("_", "-"): header for name, header in headers.items()}
        connection = http.client.HTTPConnection(*self.address, timeout=20)
        with contextlib.closing(connection):
            data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
            connection.putrequest(method, path, skip_host="Host" in fields)
            for name, field in fields.items():
                if field is not None:
                    connection.putheader(name, field)
            if data is not None and "Content-Length" not in fields:
                connection.putheader("Content-Length", str(len(data)))
            connection.endheaders(data)
            response = connection.getresponse()
            return response.status, dict(response.getheaders()), response.read()

    def post(self, path: str, **body: Any) -> Any:
        """Return what is answered, or the text of the refusal."""
        status, _, data = self.ask("POST", path, body)
        answer = json.loads(data)
        return answer if status == 200 else answer["error"]

    def refused(self, request: tuple[str, dict[str, Any]]) -> None:
        """Post to a path; raise a ValueError with the text of the refusal."""
        if isinstance(answer := self.post(request[0], **request[1]), str):
            raise ValueError(answer)

    def history(self, row: Any, seconds: Any, column: Any = "last values") -> Any:
        """Return the samples of a chart, or the text of the refusal."""
        return self.post("/history", row=row, column=column, seconds=seconds)

    @contextlib.contextmanager
    def watching(self) -> Iterator[Visitor]:
        """Open the stream; `receive` takes from it."""
        connection = http.client.HTTPConnection(*self.address, timeout=20)
        with contextlib.closing(connection):
            connection.request("GET", "/events", headers=self.headers)
            self._response = connection.getresponse()
            assert self._response.status == 200, self._response.read()
            try:
                self.receive(lambda: "page" in self.seen)
                yield self
            finally:
                self._response.close()

    def receive(self, enough: Callable[[], Any], seconds: float = 15) -> Any:
        """Take messages until this gives something, and give that."""
        end = time.monotonic() + seconds
        while not (result := enough()):
            assert time.monotonic() < end, f"waited in vain; seen: {self.seen}"
            line = self._response.readline()
            assert line, "the stream has ended"
            if line.startswith(b"data: "):
                self._take(json.loads(line[6:]))
        return result

    def _take(self, message: dict[str, Any]) -> None:
        self.messages.append(message)
        for table, changed in message.items():
            if changed is None:
                del self.seen[table]
                continue
            rows = self.seen.setdefault(table, {})
            for key, row in changed.items():
                if row is None:
                    del rows[key]
                else:
                    rows[key] = row

    def _view(self, **view: Any) -> None:
        answer = self.post("/view", stream=self.seen["page"]["stream"], **view)
        assert answer == {}, answer

    def look(self, unit: int | None, what: str, first: int, stop: int) -> None:
        """Look at points or cells of a unit."""
        self._view(unit=unit, what=what, first=first, stop=stop)

    def look_at(
        self, first: int = 0, stop: int = 50, find: str = "", *, problems: bool = False
    ) -> None:
        """Look at rows of a page with a table."""
        self._view(find=find, problems=problems, first=first, stop=stop)


@contextlib.contextmanager
def page_of(**options: Any) -> Iterator[tuple[Server, str, Visitor]]:
    """A server that serves, its Modbus URL, and who visits its page."""
    server = make_server(**options)
    with live_page(server) as page, server.background("tcp://127.0.0.1:0") as running:
        yield server, running.urls[0], Visitor(page.url)
