"""What a request reads and writes, and where it came from: for hooks, rules and audits."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping as MappingABC
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ..protocol import pdu
from ..protocol.tables import TABLE_SIZE, TABLES
from .event_log import EventLog
from .mapping import Mapping
from .records import RecordFile

if TYPE_CHECKING:
    from ..security.certificates import CertificateHolder


@dataclass(frozen=True, slots=True)
class Access:
    """
    A range of items that a client reads or writes.

    Two accesses are equal if everything but `names`, `old_values` and `device` is equal.

    Attributes:
        table: "coils", "discrete_inputs", "holding_registers", "input_registers",
            "fifo" or "file".
        address: the address of the first item, 0-based; the first record of a file.
        count: the number of items.
        values: the values to write, or written; empty for reads. They are the contents of the
            cells: registers 0..65535 as on the wire, neither decoded nor scaled, also for points.
            For points, ``access.device[name]`` is the value in `after_write`, and `Point.decode`
            decodes registers.
        file: the number of the file; 0 for other tables.
        unit: the unit of the request.
        peer: the client: "192.0.2.7:51234", or the serial port.
        role: the role in the client's certificate; None without a role, or without TLS.
        names: the names of the device's points that the access touches, in the order of their
            addresses; only set for hooks.
        old_values: for a write, the previous values, as many as `values`; only set for hooks.
        device: the `Device` that calls the hook; only set for hooks.
    """

    table: str
    address: int
    count: int
    values: tuple[Any, ...] = ()
    file: int = 0
    unit: int = 0
    peer: str = ""
    role: str | None = None
    names: tuple[str, ...] = field(default=(), compare=False)
    old_values: tuple[Any, ...] = field(default=(), compare=False)
    device: Any = field(default=None, compare=False, repr=False)


TableOrFile = tuple[str, int]
"""A table, or "file", and the number of the file; 0 for a table."""


class Accesses(NamedTuple):
    """The accesses of one request; it writes first."""

    writes: tuple[Access, ...] = ()
    reads: tuple[Access, ...] = ()


# Unit, peer and role of an `Access`.
Who = tuple[int, str, "str | None"]


Find = Callable[[Any, Mapping, Who], Accesses]


class TouchRule(NamedTuple):
    """The tables that requests of a class touch, "" for none; `find` returns what one touches."""

    reads: str
    writes: str
    find: Find


def _reading(table: str) -> TouchRule:
    def find(request: Any, _: Mapping, who: Who) -> Accesses:
        return Accesses((), (Access(table, request.address, request.count, (), 0, *who),))

    return TouchRule(table, "", find)


def _writing(
    table: str,
    values: Callable[[Any, Mapping], tuple[Any, ...]] = lambda request, _: request.values,
) -> TouchRule:
    def find(request: Any, mapping: Mapping, who: Who) -> Accesses:
        new = values(request, mapping)
        return Accesses((Access(table, request.address, len(new), new, 0, *who),))

    return TouchRule("", table, find)


def _one(request: pdu.WriteCoil | pdu.WriteRegister, _: Mapping) -> tuple[int]:
    return (request.value,)


def _masked(request: pdu.MaskWriteRegister, mapping: Mapping) -> tuple[int]:
    registers = mapping.holding_registers
    current = registers[request.address] if registers.has(request.address) else 0
    return (current & request.and_mask | request.or_mask & ~request.and_mask & 0xFFFF,)


def _read_write(request: pdu.ReadWriteRegisters, _: Mapping, who: Who) -> Accesses:
    table, new = "holding_registers", request.values
    write = Access(table, request.write_address, len(new), new, 0, *who)
    read = Access(table, request.read_address, request.read_count, (), 0, *who)
    return Accesses((write,), (read,))


def _read_files(request: pdu.ReadFileRecords, _: Mapping, who: Who) -> Accesses:
    reads = [Access("file", at, count, (), file, *who) for file, at, count in request.records]
    return Accesses((), tuple(reads))


def _written_files(request: pdu.WriteFileRecords, _: Mapping, who: Who) -> Accesses:
    writes = [Access("file", at, len(new), new, file, *who) for file, at, new in request.records]
    return Accesses(tuple(writes))


def _fifo(request: pdu.ReadFifoQueue, _: Mapping, who: Who) -> Accesses:
    return Accesses((), (Access("fifo", request.address, 1, (), 0, *who),))


ACCESSES: dict[type[pdu.Request[Any]], TouchRule] = {
    pdu.ReadCoils: _reading("coils"),
    pdu.ReadDiscreteInputs: _reading("discrete_inputs"),
    pdu.ReadHoldingRegisters: _reading("holding_registers"),
    pdu.ReadInputRegisters: _reading("input_registers"),
    pdu.WriteCoil: _writing("coils", _one),
    pdu.WriteRegister: _writing("holding_registers", _one),
    pdu.WriteCoils: _writing("coils"),
    pdu.WriteRegisters: _writing("holding_registers"),
    pdu.MaskWriteRegister: _writing("holding_registers", _masked),
    pdu.ReadWriteRegisters: TouchRule("holding_registers", "holding_registers", _read_write),
    pdu.ReadFileRecords: TouchRule("file", "", _read_files),
    pdu.WriteFileRecords: TouchRule("", "file", _written_files),
    pdu.ReadFifoQueue: TouchRule("fifo", "", _fifo),
}
"""Request class -> the rule for the accesses of its requests."""

READABLE: dict[str, int] = {
    **dict.fromkeys((*TABLES, "fifo"), TABLE_SIZE),
    "file": pdu.RECORDS_PER_FILE,
}
"""`Access.table` -> the number of its items; for "file", of each file. All can be read."""

WRITABLE: dict[str, int] = {
    kind.writes: READABLE[kind.writes] for kind in ACCESSES.values() if kind.writes
}
"""The tables of `READABLE` that can be written."""

# A device without addresses: there, the register of a masked write is 0.
_NOTHING = Mapping()


def touched(
    request: pdu.Request[Any] | None, who: Who = (0, "", None), mapping: Mapping | None = None
) -> Accesses:
    """Return the accesses of a request; the values of a masked write depend on the mapping."""
    kind = ACCESSES.get(type(request))  # type: ignore[arg-type]
    return Accesses() if kind is None else kind.find(request, mapping or _NOTHING, who)


def touched_by(data: bytes) -> Accesses:
    """Return the accesses of a request PDU; one that cannot be decoded has none."""
    try:
        request = pdu.decode_request(data)
    except Exception:
        return Accesses()
    return touched(request)


# --- the origin of a request, and its audit -------------------------------------------------------


class Caller(NamedTuple):
    """
    The origin of a request.

    Attributes:
        unit: the unit that was addressed, 0..255.
        peer: the client: "host:port", or the serial port.
        log: the event log of the line on which the request came; None for the device's own.
        is_broadcast: True if no response is sent.
        role: the role in the client's certificate; None without a role, or without TLS.
        on_unauthorized: called for each request that `authorize` does not allow, with True if it
            said so, False if it raised an exception; None for nothing.
        holder: the holder of the client's certificate; None without TLS.
        auditor: records each change, and each request that `authorize` does not allow; None for
            no audit.
    """

    unit: int = 0
    peer: str = ""
    log: EventLog | None = None
    is_broadcast: bool = False
    role: str | None = None
    on_unauthorized: Callable[[bool], object] | None = None
    holder: CertificateHolder | None = None
    auditor: Auditor | None = None

    @property
    def who(self) -> tuple[int, str, str | None]:
        """Unit, peer and role of an `Access`."""
        return self.unit, self.peer, self.role

    def telling(self, note: Callable[[bool], object]) -> Caller:
        """Return a caller for which another function is called first, as `on_unauthorized` is."""
        before = self.on_unauthorized

        def both(is_said: bool) -> None:
            note(is_said)
            if before is not None:
                before(is_said)

        return self._replace(on_unauthorized=both)


class ValueChange(NamedTuple):
    """
    A range of items that a request writes.

    Attributes:
        access: the table, the addresses and the new values.
        before: the previous values; None if they are not known.
    """

    access: Access
    before: tuple[Any, ...] | None


class ExecutedRequest(NamedTuple):
    """A request with its outcome: a change, or one that was refused."""

    caller: Caller
    request: bytes
    response: bytes  # empty without a response
    changes: tuple[ValueChange, ...]  # the values that the request writes, or would have written
    is_change: bool


class Auditor(Protocol):
    """Records who changed what."""

    def may_change(self) -> bool:
        """Return False if changes must be refused, because none can be recorded."""
        ...

    def note(self, request: ExecutedRequest) -> None:
        """Record a request. Never raises."""


def changes_of(
    request: pdu.Request[Any] | None,
    caller: Caller,
    mapping: Mapping | None = None,
    files: MappingABC[int, RecordFile] = MappingProxyType({}),
) -> tuple[ValueChange, ...]:
    """Return the values that a request writes, and those before, if the device is here."""
    writes = touched(request, caller.who, mapping).writes
    if mapping is not None:
        return tuple(ValueChange(write, values_at(write, mapping, files)) for write in writes)
    if isinstance(request, pdu.MaskWriteRegister):  # its result depends on the value before
        writes = tuple(replace(write, values=()) for write in writes)
    return tuple(ValueChange(write, None) for write in writes)


def values_at(
    access: Access, mapping: Mapping, files: MappingABC[int, RecordFile]
) -> tuple[Any, ...] | None:
    """Return the present values; None if an address does not exist."""
    first, count = access.address, access.count
    if access.table == "file":
        file = files.get(access.file)
        return tuple(file.read(first, count)) if file and file.has(first, count) else None
    table = getattr(mapping, access.table)
    return tuple(table[first : first + count]) if table.has(first, count) else None
