"""SunSpec devices for tests: chains of models as registers, and servers of them."""

import json
import struct
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.protocol.errors import IllegalDataAddress, ModbusError

MARKER = [0x5375, 0x6E53]
END = [0xFFFF, 0]


def chain(*models: Sequence[int], end: Sequence[int] = END) -> list[int]:
    """Return the registers of a chain; each model begins with its id and its own idea of length."""
    return [*MARKER, *(cell for model in models for cell in model), *end]


def file_device(name: str) -> list[int]:
    """Return the registers of a device that pysunspec2 has in a file for its own tests."""
    import sunspec2
    from sunspec2.file.client import FileClientModel

    path = Path(sunspec2.__file__).parent / "tests" / "test_data" / name
    models = []
    for model in json.loads(path.read_text())["models"]:
        if model["ID"] == END[0]:
            break
        data = FileClientModel(model["ID"], 0, model.get("L"), data=model).get_mb()
        cells = list(struct.unpack(f">{len(data) // 2}H", data))
        models.append([cells[0], len(cells) - 2, *cells[2:]])  # one file has models without lengths
    return chain(*models)


@contextmanager
def serving(cells: Sequence[int], base: int = 40000) -> Generator[str]:
    """Serve registers from an address on, and no others; gives the URL."""
    device = Device(Mapping(holding_registers={base: list(cells)}))
    with Server(device).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


class Walk:
    """
    A procedure that is carried out on registers in memory. `result`: its result; `requests`:
    address and count of each of its requests.
    """

    def __init__(self, steps: Generator[Any, Any, Any], cells: dict[int, int]) -> None:
        self.requests: list[tuple[int, int]] = []
        self.result: Any = None
        try:
            step = next(steps)
            while True:
                answer = self._answer(step, cells)
                is_error = isinstance(answer, ModbusError)
                step = steps.throw(answer) if is_error else steps.send(answer)
        except StopIteration as done:
            self.result = done.value

    def _answer(self, request: Any, cells: dict[int, int]) -> Any:
        addresses = range(request.address, request.address + request.count)
        self.requests.append((request.address, request.count))
        assert 1 <= request.count <= 125
        assert addresses.stop <= 65536
        if not all(at in cells for at in addresses):
            return IllegalDataAddress()
        return [cells[at] for at in addresses]


def walk_through(steps: Generator[Any, Any, Any], cells: Iterable[int], base: int = 40000) -> Walk:
    """Carry out a procedure on registers from an address on."""
    return Walk(steps, dict(enumerate(cells, base)))
