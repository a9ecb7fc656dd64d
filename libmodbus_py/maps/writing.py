"""
Values that are written to points: from the text that a person typed, and as few requests, of which
none is sent before all values are checked.
"""

from __future__ import annotations

import contextlib
import json
import math
import reprlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

from ..protocol import pdu
from ..protocol.checks import shown
from ..protocol.json_text import each_once
from ..protocol.mistakes import WrongValue, inside
from ..protocol.plain import BITS, bit_of, decimal_of, number_of, value_of
from ..protocol.tables import TABLES, WriteFunction
from .meaning import CellChange
from .point import Point

if TYPE_CHECKING:
    from decimal import Decimal

Result = TypeVar("Result")

# Table -> the requests that write one cell, and several.
_WRITES: dict[str, tuple[Any, Any]] = {
    "coils": (pdu.WriteCoil, pdu.WriteCoils),
    "holding_registers": (pdu.WriteRegister, pdu.WriteRegisters),
}


def cell_requests(
    table: str, address: int, cells: Sequence[Any], function: WriteFunction
) -> list[pdu.Request[None]]:
    """Return the requests that write cells: one for all, or one for each with "single"."""
    one, many = _WRITES[table]
    if function == "multiple" or (function == "auto" and len(cells) > 1):
        return [many(address, cells)]
    return [one(address + at, cell) for at, cell in enumerate(cells)]


@dataclass
class _Run:
    """Consecutive cells that are written with a function."""

    table: str
    address: int
    cells: list[Any]
    function: WriteFunction

    @property
    def stop(self) -> int:
        return self.address + len(self.cells)

    def takes(self, other: _Run) -> bool:
        most = TABLES[self.table].most_written
        end = self.table, self.stop, self.function
        touches = (other.table, other.address, other.function) == end
        return touches and len(self.cells) + len(other.cells) <= most

    @property
    def requests(self) -> list[pdu.Request[None]]:
        return cell_requests(self.table, self.address, self.cells, self.function)


@dataclass
class _Masked:
    """Bits of one register to write; the other bits stay as they are."""

    address: int
    function: WriteFunction
    bits: int = 0
    mask: int = 0

    @property
    def requests(self) -> list[pdu.Request[None]]:
        if self.mask == 0xFFFF:
            return cell_requests("holding_registers", self.address, [self.bits], self.function)
        return [pdu.MaskWriteRegister(self.address, 0xFFFF & ~self.mask, self.bits)]


def write_requests(
    changes: Iterable[tuple[Point, Any, Any]], function: WriteFunction
) -> list[pdu.Request[None]]:
    """
    Return the requests that write values to points, in their order; all values are checked.

    Neighbours are written with one request, parts of one register with one of function 22;
    `function` is for the points that name none of their own.
    """
    runs: list[_Run | _Masked] = []
    masks_by_address: dict[int, _Masked] = {}
    pairs = [(point, point.change(value, source=source)) for point, value, source in changes]
    check_overlaps(pairs)
    for point, (cells, masks) in pairs:
        own = point.write_function or function
        if masks is not None:
            for address, bits, mask in zip(point.cells, cells, masks, strict=True):
                if mask and address not in masks_by_address:
                    masks_by_address[address] = _Masked(address, own)
                    runs.append(masks_by_address[address])
                if mask:
                    masks_by_address[address].bits |= bits
                    masks_by_address[address].mask |= mask
            continue
        for piece in _pieces(point, cells, own):
            last = runs[-1] if runs else None
            if isinstance(last, _Run) and last.takes(piece):
                last.cells += piece.cells
            else:
                runs.append(piece)
    return [*chain.from_iterable(run.requests for run in runs)]


def _pieces(point: Point, cells: list[Any], function: WriteFunction) -> Iterator[_Run]:
    """Yield cells that must stay together: a point if it fits into one request, else a value."""
    most, size = TABLES[point.table].most_written, point.read.size
    if size > most:
        reason = f"{point.type} takes {size} registers, a write at most {most}"
        raise WrongValue.about(point.name, reason)
    step = len(cells) if len(cells) <= most else size
    for at in range(0, len(cells), step):
        yield _Run(point.table, point.address + at, cells[at : at + step], function)


def check_overlaps(changes: Iterable[tuple[Point, CellChange]]) -> None:
    """Raise ValueError, with both names, if two changes of points share cells or bits of them."""
    pairs = sorted(changes, key=lambda change: (change[0].table, change[0].address))
    # The bits that points occupy in the cells of the table, and the first point there.
    writers: dict[tuple[str, int], tuple[int, str]] = {}
    for point, (_, masks) in pairs:
        for at, address in enumerate(point.cells):
            mask = 0xFFFF if masks is None else masks[at]
            before, first = writers.get((point.table, address), (0, point.name))
            if before & mask:
                names, cell = f"{first} and {point.name}", f"{point.table} {address}"
                raise ValueError(f"{names} share {cell}: write one of them")
            writers[point.table, address] = before | mask, first


def check_cells(point: Point, cells: Sequence[Any], *, source: Any = None) -> None:
    """
    Check values that someone else has encoded against the bounds of a point.

    The nearest value to a bound that the type has is within it: 0.1 as a float32 is not above 0.1.
    """
    if not point.has_bounds:
        return
    # Integers hold a bound, or it lies between two of them; so do those that another point scales.
    is_exact = bool(point.step) or point.scale_from is not None
    bounds = [] if is_exact else _held_bounds(point)
    scaling = point.scaling_for(source)
    try:
        for value in point.values_in(cells, scaling):
            if value is None:
                raise WrongValue("value", "must not be the raw value that means no value")
            if value not in bounds:
                point.check_bounds(value)
    except ValueError as error:
        raise WrongValue.about(point.name, str(error)) from None


def _held_bounds(point: Point) -> list[Any]:
    """Return the values that cells hold in which the bounds are written."""
    bounds: list[Any] = []
    for bound in (point.minimum, point.maximum):
        with contextlib.suppress(ValueError):  # cells cannot have every bound as their value
            bounds += [] if bound is None else point.values_in(point.cells_for([bound]))
    return bounds


# --- typed text -----------------------------------------------------------------------------


def typed_value(point: Point, text: str) -> Any:
    """
    Return one value, as `Point.encode` takes it, or raise a ValueError that begins with "value".

    Spaces around the text are ignored, except in strings. Scaled numbers are decimal and exact:
    one that a float cannot hold becomes an int or a Decimal.
    """
    if point.states is not None:
        return _state(point, point.states, text.strip())
    if point.bits is not None:
        return _named_bits(text)
    kind, part = point.read.kind, point.meaning.part
    if kind is None or (part is not None and part.is_flag):
        return bit_of(text.strip())
    if kind.is_text:
        return value_of(text, kind)
    is_plain = (point.scale, point.offset, point.scale_from) == (1, 0, None)
    if is_plain and part is not None:
        return number_of("value", text.strip())
    if is_plain or (kind.limits is None and part is None):
        return value_of(text.strip(), kind)
    return _exact(text)


def typed_values(point: Point, text: str) -> Any:
    """
    Return the value of a point that a text says; a list, of values between commas, if it has some.

    Named bits contain commas themselves, and so may the names of states: these are a JSON array.
    """
    if point.count == 1:
        return typed_value(point, text)
    if point.bits is not None or (point.states is not None and text.lstrip().startswith("[")):
        return _json(text, list, "array")
    return [typed_value(point, word.strip()) for word in text.split(",")]


def _state(point: Point, states: Mapping[Any, str], text: str) -> Any:
    if text in states.values():
        return text
    kind = None if point.meaning.part is not None else point.read.kind
    try:
        return number_of("value", text) if kind is None else value_of(text, kind)
    except ValueError:
        choices = ", ".join(states.values())
        raise ValueError(f"value must be one of {choices}, or a number, not {text!r}") from None


def _named_bits(text: str) -> dict[str, int]:
    """Return the bits of "door=1, mode=5", or of a JSON object."""
    if text.lstrip().startswith("{"):
        return _json(text, dict, "object")
    pairs: list[tuple[str, int]] = []
    for pair in text.split(","):
        name, separator, value = pair.partition("=")
        if not separator:
            raise ValueError(f"value must be like name=1, other=0, or a JSON object, not {text!r}")
        value = value.strip().lower()
        bits = BITS[value] if value in BITS else number_of("value", value)
        pairs.append((name.strip(), bits))
    with inside("value"):
        return each_once(pairs)


def json_value(point: Point, value: Any) -> Any:
    """Return a value of JSON as `Point.encode` takes it: times are text (ISO 8601)."""
    kind = point.read.kind
    if kind is None or not kind.is_time:
        return value
    if point.count > 1 and isinstance(value, list):
        return [value_of(item, kind) if isinstance(item, str) else item for item in value]
    return value_of(value, kind) if isinstance(value, str) else value


def _json(text: str, kind: type[Result], name: str) -> Result:
    """Return the object or array that a text contains as JSON."""
    try:
        value = json.loads(text, object_pairs_hook=each_once)
    except WrongValue as mistake:
        raise mistake.under(("value",)) from None
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, kind):
        raise ValueError(f"value must be a JSON {name}, not {reprlib.repr(text)}")
    return value


def typed_register(text: str) -> int:
    """Return one register; -1 is 65535, because both are the same 16 bits. Raises ValueError."""
    value = number_of("value", text)
    if not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"value must be in -32768..65535, not {shown(value)}")
    return value & 0xFFFF


def _exact(text: str) -> int | float | Decimal:
    nearest = decimal_of(text)  # which also limits the exponent of what is computed with
    if not nearest or not math.isfinite(nearest):
        return nearest
    from decimal import Decimal

    exact = Decimal(text)
    if exact == exact.to_integral_value():
        return int(exact)
    return nearest if exact == Decimal(repr(nearest)) else exact
