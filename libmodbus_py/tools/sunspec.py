"""
Finds the SunSpec models of a device: the walk along their chain yields requests, and is sent
answers. The definitions of models are JSON files that pysunspec2 carries; a `ModelLayout` lays the
points of one over the registers of a model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Coroutine, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar, overload

from ..client.functions_async import AsyncFunctions
from ..client.functions_blocking import BlockingFunctions
from ..maps.point import Point
from ..maps.point_checks import TEXTS
from ..maps.register_map import RegisterMap
from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import ExceptionResponse, ModbusError
from ..protocol.mistakes import WrongType, WrongValue
from ..protocol.tables import TABLE_SIZE, Table
from ..version import what_is_missing

BASES = (0, 40000, 50000)
"""The addresses at which SunSpec allows a chain to begin."""

# The registers of "SunS", with which a chain begins, and the id of the end model.
MARKER = [0x5375, 0x6E53]
END = 0xFFFF

MOST_MODELS = 256  # the longest chains of real devices have some thirty models
MOST_BASES = 16  # addresses at which a chain is sought; SunSpec names three

Result = TypeVar("Result")

# A walk yields requests, and is sent their results; what fails is raised in it.
_Steps: TypeAlias = Generator[pdu.ReadHoldingRegisters, Any, Result]


class SunSpecError(ModbusError):
    """The device has no chain of SunSpec models at the given addresses."""


class _Header(NamedTuple):
    """The header of one model: its id and address, and the number of registers that follow."""

    id: int
    address: int
    length: int

    def __str__(self) -> str:
        return f"model {self.id} at address {self.address}"


@dataclass
class _Chain:
    """The headers of a chain of models between the marker and the end model, if there is one."""

    base: int
    headers: list[_Header] = field(default_factory=list)
    end: int | None = None
    notes: list[str] = field(default_factory=list)


def walk(bases: Iterable[int]) -> _Steps[_Chain]:
    """Find the marker, and follow the chain to its end."""
    reasons = []
    for base in bases:
        answer = yield from _asked(base, len(MARKER))
        if answer == MARKER:
            chain = _Chain(base)
            chain.notes += yield from _followed(chain)
            return chain
        problem = answer if isinstance(answer, ExceptionResponse) else "no SunS there"
        reasons.append(f"address {base}: {problem}")
    raise SunSpecError(f"the device has no SunSpec models: {'; '.join(reasons)}")


def _followed(chain: _Chain) -> _Steps[list[str]]:
    """Add the headers and the end of a chain; return what is wrong with it."""
    address = chain.base + len(MARKER)
    while len(chain.headers) < MOST_MODELS:
        if address + HEADER > TABLE_SIZE:
            return ["the chain has no end model before address 65535"]
        answer = yield from _asked(address, HEADER)
        if isinstance(answer, ExceptionResponse):
            return [f"the chain has no end model: address {address}: {answer}"]
        header = _Header(answer[0], address, answer[1])
        if header.id == END:
            chain.end = address
            return []
        if header.id == 0:
            return [f"the chain has no end model: there is no model 0, as at address {address}"]
        address += HEADER + header.length
        if address > TABLE_SIZE:
            reason = f"its length, {header.length}, leads beyond address 65535"
            return [f"{header} is left out: {reason}"]
        chain.headers.append(header)
    return [f"the chain has more than {MOST_MODELS} models; the rest is left out"]


def _asked(address: int, count: int) -> _Steps[list[int] | ExceptionResponse]:
    """Ask for registers; return them, or the exception response."""
    try:
        return (yield pdu.ReadHoldingRegisters(address, count))  # type: ignore[no-any-return]
    except ExceptionResponse as refusal:
        return refusal


# --- results --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SunSpecModel:
    """
    One model of a device.

    Attributes:
        id: the id of the model, such as 103; 1..65534.
        address: the address of the register with the id.
        length: the number of registers after id and length.
        name: the name of the model, such as "common", unique in its device; "model_64999" if the
            model is not known.
        label: the title of the model, or empty.
        is_known: True if pysunspec2 has a definition of the model; if not, the point `registers`
            contains all registers after the header.
        map: the points, with `ID` and `L`. The names of points in repeated groups are like
            "module.1.DCA", counted from 1.
    """

    id: int
    address: int
    length: int
    name: str
    label: str
    is_known: bool
    map: RegisterMap


@dataclass(frozen=True)
class SunSpecDevice:
    """
    The models of a device.

    Attributes:
        base: the address at which the chain begins, with "SunS".
        models: in the order of the chain.
        end: the address of the end model; None if the chain ends without one.
        notes: what is wrong with the chain or its models, each as one sentence.
    """

    base: int
    models: tuple[SunSpecModel, ...]
    end: int | None
    notes: tuple[str, ...]

    @cached_property
    def map(self) -> RegisterMap:
        """The points of all models, such as "common.Mn", with the marker and the end model."""
        points = [
            Point("SunS", "holding_registers", self.base, len(MARKER), access="read"),
            *(point for model in self.models for point in _prefixed(model)),
        ]
        if self.end is not None:
            points.append(Point("end.ID", "holding_registers", self.end, access="read"))
            points.append(Point("end.L", "holding_registers", self.end + 1, access="read"))
        return RegisterMap(points)

    def __getitem__(self, model: int | str) -> SunSpecModel:
        """
        Return the first model with this id or name.

        Raises:
            KeyError: the device has none.
        """
        for candidate in self.models:
            if model in (candidate.id, candidate.name):
                return candidate
        raise KeyError(model)

    def __iter__(self) -> Iterator[SunSpecModel]:
        return iter(self.models)

    def __len__(self) -> int:
        return len(self.models)


def _prefixed(model: SunSpecModel) -> Iterator[Point]:
    for point in model.map.values():
        source = point.scale_from
        yield replace(
            point,
            name=f"{model.name}.{point.name}",
            scale_from=None if source is None else f"{model.name}.{source}",
        )


# --- discovery ------------------------------------------------------------------------------------


def definition_of(model: int) -> Mapping[str, Any] | None:
    """Return the top-level group of a model's definition; None if the model is not known."""
    path = folder() / f"model_{model}.json"
    if not path.is_file():
        return None
    group: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))["group"]
    return group


def folder() -> Path:
    """Return the folder of the definitions, files such as "model_103.json"."""
    # Its client, which needs pyserial, is not imported.
    package = find_spec("sunspec2")
    for parent in (package and package.submodule_search_locations) or ():
        path = Path(parent, "models", "json")
        if path.is_dir():
            return path
    raise ImportError(what_is_missing("SunSpec", "sunspec"), name="sunspec2")


@overload
def discover(client: BlockingFunctions, *, bases: Iterable[int] = BASES) -> SunSpecDevice: ...
@overload
def discover(
    client: AsyncFunctions, *, bases: Iterable[int] = BASES
) -> Coroutine[Any, Any, SunSpecDevice]: ...
def discover(client: Any, *, bases: Iterable[int] = BASES) -> Any:
    """
    Find the SunSpec models of a device: ``sunspec.discover(plc)``, or with ``await``.

    It sends one request for each base that is tried, one for each model, and a few more for models
    with a variable number of groups. It returns at most 256 models and 10000 points. A point
    whose scale factor the device lacks has no value.

    Args:
        client: a `Client` or an `AsyncClient`; requests are sent to its unit.
        bases: 1..16 addresses at which the chain may begin, 0..65535, tried in this order.

    Returns:
        The models and their points; a coroutine with an `AsyncClient`. If the chain contains an
        error, the result ends there, and `notes` describe the error.

    Raises:
        TypeError, ValueError: an argument is wrong.
        ImportError: pysunspec2, which contains the definitions of the models, is not installed.
        SunSpecError: the registers at none of the bases hold "SunS".
        ModbusError: a request failed.
    """
    if not isinstance(client, BlockingFunctions | AsyncFunctions):
        raise WrongType("client", f"must be a client, not {type(client).__name__}")
    folder()  # before anything is sent
    return client._carry_out(_discovery(_checked_bases(bases)))


def _checked_bases(bases: Iterable[int]) -> tuple[int, ...]:
    if isinstance(bases, str | bytes) or not isinstance(bases, Iterable):
        raise WrongType("bases", f"must be a list of addresses, not {type(bases).__name__}")
    most = TABLE_SIZE - len(MARKER)
    addresses = tuple(integer(("bases", at), base, 0, most) for at, base in enumerate(bases))
    if not 1 <= len(addresses) <= MOST_BASES:
        raise WrongValue("bases", f"must hold 1..{MOST_BASES} addresses, not {len(addresses)}")
    return tuple(dict.fromkeys(addresses))


def _discovery(bases: Iterable[int]) -> _Steps[SunSpecDevice]:
    chain = yield from walk(bases)
    models: list[SunSpecModel] = []
    room = MOST_POINTS
    # The second model of a name ends with 2, and so on.
    uses = {"end": 1, "SunS": 1}
    for header in chain.headers:
        definition = definition_of(header.id)
        group = _made_up(header) if definition is None else definition
        name = group["name"]
        uses[name] = uses.get(name, 0) + 1
        if uses[name] > 1:
            name = f"{name}_{uses[name]}"
        counts = yield from _counts(chain, header, group)
        layout = ModelLayout(group, header.address, header.length, counts, room)
        room -= len(layout.points)
        remark = f"{header} has the length {header.length}"
        chain.notes += [f"{remark}: {note}" for note in layout.notes]
        rest = HEADER + header.length - layout.used
        if rest and not layout.notes:
            chain.notes.append(f"{header} has {rest} registers more than its definition")
        map, label = RegisterMap(layout.points), group.get("label", "")
        models.append(SunSpecModel(*header, name, label, definition is not None, map))
    return SunSpecDevice(chain.base, tuple(models), chain.end, tuple(chain.notes))


def _counts(chain: _Chain, header: _Header, group: Mapping[str, Any]) -> _Steps[dict[str, int]]:
    """Read the points by which groups are repeated, which are adjacent in all definitions."""
    offsets = counters_of(group)
    offsets = {name: at for name, at in offsets.items() if at < HEADER + header.length}
    if not offsets:
        return {}
    first, last = min(offsets.values()), max(offsets.values())
    cells = yield from _asked(header.address + first, last - first + 1)
    if isinstance(cells, ExceptionResponse):
        chain.notes.append(f"{header}: its repeated groups are left out: {cells}")
        return {}
    counts = {name: cells[at - first] for name, at in offsets.items()}
    return {name: 0 if count == NOT_IMPLEMENTED else count for name, count in counts.items()}


def _made_up(header: _Header) -> dict[str, Any]:
    """Return the definition of a model that has none: its registers as they are."""
    points: list[dict[str, Any]] = [
        {"name": name, "type": "register", "size": 1} for name in ("ID", "L")
    ]
    if header.length:
        rest = {"name": "registers", "type": "register", "size": header.length, "access": "RW"}
        points.append(rest)
    return {"name": f"model_{header.id}", "points": points}


# --- the points of one model ----------------------------------------------------------------------


TABLE: Table = "holding_registers"

HEADER = 2  # registers of the header of a model: id and length
MOST_POINTS = 10000  # points of one device, as many as a map file may have
LONGEST_TEXT = 125  # registers; a longer text is kept as registers
NOT_IMPLEMENTED = 0xFFFF  # the register of a number of groups that the device does not have

# Type of SunSpec -> keys of a point. An accumulator that a device lacks is 0.
_TYPES: dict[str, dict[str, Any]] = {
    **{
        name: {"type": name, "missing": "sunspec"}
        for name in ("int16", "uint16", "int32", "uint32", "int64", "uint64")
    },
    **{f"acc{size}": {"type": f"uint{size}", "missing": 0} for size in (16, 32, 64)},
    **{f"enum{size}": {"type": f"uint{size}", "missing": "sunspec"} for size in (16, 32)},
    **{f"bitfield{size}": {"type": f"bits{size}", "missing": "sunspec"} for size in (16, 32, 64)},
    **{f"float{size}": {"type": f"float{size}"} for size in (32, 64)},
    "count": {"type": "uint16", "missing": "sunspec"},
    "sunssf": {"type": "int16", "missing": "sunspec"},
    "ipaddr": {"type": "uint32", "missing": 0},
    "eui48": {"type": "eui48", "missing": "sunspec"},
}


class ModelLayout:
    """The points of a definition, laid over the registers of a model, `room` of them at most."""

    def __init__(
        self,
        group: Mapping[str, Any],
        address: int,
        length: int,
        counts: Mapping[str, int],
        room: int = MOST_POINTS,
    ) -> None:
        self.points: list[Point] = []
        self.notes: list[str] = []
        self._at, self._stop = address, address + HEADER + length
        self._counts, self._room = counts, room
        self._lay(group, "", {})
        self.used: int = self._at - address
        names = {None, *(point.name for point in self.points)}
        points = [point for point in self.points if point.scale_from in names]
        if unscaled_count := len(self.points) - len(points):
            self.notes.append(f"{unscaled_count} points are left out with their scale factors")
        self.points = points

    def _lay(self, group: Mapping[str, Any], prefix: str, scales: Mapping[str, str]) -> bool:
        """Lay one group, and those inside it; return False if it does not fit."""
        own = {
            point["name"]: prefix + point["name"]
            for point in group["points"]
            if point["type"] == "sunssf"
        }
        names = {**scales, **own}
        for point in group["points"]:
            if self._at + point["size"] > self._stop:
                if point["type"] != "pad":
                    self.notes.append(f"{prefix}{point['name']} and what follows do not fit")
                return False
            if len(self.points) >= self._room:
                self.notes.append(f"there are too many points: {prefix}{point['name']} is left out")
                return False
            if point["type"] != "pad":
                self.points.append(
                    Point(prefix + point["name"], TABLE, self._at, **_keys(point, names))
                )
            self._at += point["size"]
        return all(self._lay_all(inner, prefix, names) for inner in group.get("groups", ()))

    def _lay_all(self, group: Mapping[str, Any], prefix: str, scales: Mapping[str, str]) -> bool:
        """Lay a group as often as it is repeated; return False if one does not fit."""
        name, count = f"{prefix}{group['name']}", group.get("count")
        if count is None:
            return self._lay(group, f"{name}.", scales)
        if count == 0:  # as many as fit
            size, room = _size(group), self._stop - self._at
            count = room // size
            if room % size:
                self.notes.append(
                    f"{name} takes {size} registers each, and {room} is not a multiple"
                )
        elif isinstance(count, str):
            count = self._counts.get(count, 0)
        return all(self._lay(group, f"{name}.{at}.", scales) for at in range(1, count + 1))


def _size(group: Mapping[str, Any]) -> int:
    """Return the registers of a group whose inner groups are not repeated."""
    own: int = sum(point["size"] for point in group["points"])
    return own + sum(_size(inner) for inner in group.get("groups", ()))


def counters_of(group: Mapping[str, Any]) -> dict[str, int]:
    """Return the top-level points by which groups are repeated: name -> offset from the id."""
    names = set(_counted_by(group))
    counters, at = {}, 0
    for point in group["points"]:
        if point["name"] in names:
            counters[point["name"]] = at
        at += point["size"]
    return counters


def _counted_by(group: Mapping[str, Any]) -> Iterator[str]:
    for inner in group.get("groups", ()):
        if isinstance(count := inner.get("count"), str):
            yield count
        yield from _counted_by(inner)


def _keys(point: Mapping[str, Any], scales: Mapping[str, str]) -> dict[str, Any]:
    """Return the keys of a point but its name and address."""
    kind, size = point["type"], point["size"]
    description = " ".join((point.get("desc") or point.get("label") or "").split())
    keys = {
        "access": "read_write" if point.get("access") == "RW" else "read",
        "units": point.get("units", "").strip(),
        "description": "".join(filter(str.isprintable, description))[: TEXTS["description"][1]],
    }
    if kind == "string" and size <= LONGEST_TEXT:
        return {**keys, "type": f"string:{2 * size}", "encoding": "utf-8", "missing": "sunspec"}
    if kind not in _TYPES:  # an IPv6 address, a long text, or registers as they are
        return {**keys, "count": size}
    keys |= _TYPES[kind]
    if kind.startswith("enum"):
        keys |= _named("states", point)
    elif kind.startswith("bitfield"):
        keys |= _named("bits", point, 16 * size)
    elif isinstance(scale := point.get("sf"), int):
        keys["scale"] = 10**scale if scale >= 0 else float(f"1e{scale}")
    elif isinstance(scale, str) and scale in scales:
        keys["scale_from"] = scales[scale]
    return keys


def _named(key: str, point: Mapping[str, Any], width: float = math.inf) -> dict[str, Any]:
    """Return the states of a point, or its bits, of which there are `width`."""
    names: dict[int, str] = {}
    for symbol in point.get("symbols") or ():
        number, name = symbol["value"], symbol["name"]
        if 0 <= number < width:
            names[number] = name if name not in names.values() else f"{name}_{number}"
    return {key: names} if names else {}
