"""The command write: a request for each item, all checked before the first is sent."""

from __future__ import annotations

import argparse
import re
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

from ...client.blocking import Client
from ...maps.writing import cell_requests, typed_register, typed_value
from ...protocol import pdu
from ...protocol.errors import IllegalFunction, ModbusError
from ...protocol.framing import Frame, make_framer
from ...protocol.plain import bit_of, number_of, value_of
from ...protocol.tables import TABLES
from ..arguments import endpoint_of, new_client
from ..main import CommandError
from ..output import complain, counted
from .formatters import aligned, result_of
from .items import Item, Words, reason_of

if TYPE_CHECKING:
    from ...maps.register_map import RegisterMap
    from ...protocol.tables import WriteFunction

Request = pdu.Request[Any]

OTHERS = {
    5: "; --multiple writes with function 15",
    6: "; --multiple writes with function 16",
    15: "; --write-function single writes with function 5",
    16: "; --write-function single writes with function 6",
}
"""Function that a device may lack -> how to write with another one."""


class Write(NamedTuple):
    """An item, the values that were typed for it, and the requests that write them."""

    item: Item
    texts: list[str]
    requests: list[Request]


def write(options: argparse.Namespace) -> int:
    """Send the requests, or print them for --dry-run; return 1 if --verify finds a difference."""
    words = Words(options, options.what, have_values=True)
    writes = _writes(options, words)
    requests = [(write.item, request) for write in writes for request in write.requests]
    if options.dry_run:
        _show(options, [request for _, request in requests])
        return 0
    endpoint = endpoint_of(options)
    client = endpoint.client_options
    has_broadcast = not endpoint.has_transactions and client.get("broadcast", True)
    is_broadcast = has_broadcast and client.get("unit") == 0
    if options.verify and is_broadcast:
        raise ValueError("--verify cannot be used with unit 0: nothing answers a broadcast")
    with closing(new_client(options)) as context:
        for count, (item, request) in enumerate(requests):
            try:
                result = context.execute(request)
            except ModbusError as error:
                earlier = f"; carried out before: {counted(count, 'request')}" * bool(count)
                hint = OTHERS.get(request.function, "") * isinstance(error, IllegalFunction)
                raise CommandError(f"{reason_of(error, item)}{hint}{earlier}") from None
            if isinstance(request, pdu.ReadWriteRegisters):
                first = Item("holding_registers", request.read_address, base=item.base)
                print("\n".join(aligned([result_of(first, result)])))
        # After the last write, because one write may change the cells of another.
        differing: list[str] = []
        for write in writes:
            found_values = _verified(context, write, differing) if options.verify else None
            if options.screen.isatty():
                _say(context, words.map, write, found_values)
    for line in differing:
        complain(line)
    return 1 if differing else 0


def _show(options: argparse.Namespace, requests: list[Request]) -> None:
    """Print the requests as frames of the endpoint, in the order of sending."""
    endpoint = endpoint_of(options)
    new_client(options).close()  # checks the options
    framer = make_framer(endpoint.framing, "client")
    unit = endpoint.client_options.get("unit", 1)
    for number, request in enumerate(requests, 1):
        adu = framer.encode(Frame(unit, request.encode(), number))
        text = repr(adu.decode())[1:-1] if endpoint.framing == "ascii" else adu.hex(" ")
        print(f"> {text}  unit {unit}, {request}")


def _say(context: Client, map: RegisterMap | None, write: Write, cells: list[int] | None) -> None:
    """Print the written values, and the cells that --verify read; None without it."""
    item = write.item
    name = item.label() if item.point is None else item.point.name
    line = f"{name}: wrote {' '.join(write.texts) or 'the bits of the mask'}"
    if cells is not None and item.point is not None and map is not None:
        value = context.read_map(map, [name])[name]
        line += f", read back {value} {item.point.units}".rstrip()
    elif cells is not None:
        rows = result_of(item._replace(count=len(cells) // item.size), cells).rows
        line += f", read back {' '.join(row.text for row in rows)}"
    print(line)


# --- requests ------------------------------------------------------------------------


def _writes(options: argparse.Namespace, words: Words) -> list[Write]:
    """Return the writes in the order typed, which devices may depend on."""
    writes: list[Write] = []
    while words:
        item = words.take_item()
        texts = words.take_values()
        if words.map is not None and item.point is not None:
            requests = _point_requests(options, words.map, item, texts)
        else:
            requests = _requests(options, item, texts)
        writes.append(Write(item, texts, requests))
    if len(writes) > 1 and (options.mask or options.and_read):
        raise ValueError("--mask and --and-read allow one item only")
    return writes


def _point_requests(
    options: argparse.Namespace, points: RegisterMap, item: Item, texts: list[str]
) -> list[Request]:
    """Return the requests for a point; its scale is read first if registers depend on it."""
    point = item.point
    assert point is not None
    if options.mask or options.and_read:
        raise ValueError("--mask and --and-read need a register, not a name")
    if len(texts) != item.count:
        many = counted(item.count, "value")
        raise ValueError(f"{point.name} needs {many} after its name, not {len(texts)}")
    try:
        values = [typed_value(point, text) for text in texts]
    except ValueError as error:
        raise ValueError(f"{point.name}: {error}") from None
    new_values = {point.name: values[0] if item.count == 1 else values}
    names = points.scale_sources(new_values)
    if names and options.dry_run:
        raise ValueError(f"--dry-run asks no device, and {names[0]} of the device is the scale")
    scales: dict[str, Any] = {}
    if names:
        with closing(new_client(options)) as context:
            scales = context.read_map(points, names)
    return [*points.writes(new_values, write_function=_function(options), sources=scales)]


def _function(options: argparse.Namespace) -> WriteFunction:
    client = endpoint_of(options).client_options
    return "multiple" if options.multiple else client.get("write_function", "auto")


def _requests(options: argparse.Namespace, item: Item, texts: list[str]) -> list[Request]:
    if item.table in ("discrete_inputs", "input_registers", "fifo_queue"):
        raise ValueError(f"{item.table.replace('_', ' ')} can only be read")
    for flag, is_set in (("--mask", options.mask), ("--and-read", options.and_read)):
        if is_set and item.table != "holding_registers":
            raise ValueError(f"{flag} is for holding registers, not {item.label()}")
    if options.mask and (texts or item.bit is not None):
        raise ValueError("--mask excludes values, and a bit such as hr 10.3")
    if options.mask:
        masks = [number_of("mask", text) for text in options.mask]
        return [pdu.MaskWriteRegister(item.address, *masks)]
    if not texts:
        raise ValueError(f"there is no value to write to {item.label()}")
    if item.bit is not None:
        if len(texts) > 1 or options.and_read:
            raise ValueError(f"{item.label()} is one bit: it takes one value, and no --and-read")
        bit = 1 << item.bit
        return [pdu.MaskWriteRegister(item.address, 0xFFFF - bit, bit * bit_of(texts[0]))]
    if item.is_range and len(texts) != item.count:
        raise ValueError(f"the range from {item.label()} on needs {item.count} values")
    if item.table == "coils":
        bits = [bit_of(text) for text in texts]
        return [*cell_requests("coils", item.address, bits, _function(options))]
    if item.kind is None:
        values = tuple(map(_register, texts))
    else:
        values = tuple(item.kind.encode_many([value_of(text, item.kind) for text in texts]))
    if options.and_read:
        first, count = map(number_of, ("address", "count"), options.and_read)
        return [pdu.ReadWriteRegisters(first - item.base, count, item.address, values)]
    if item.table == "file":
        return [pdu.WriteFileRecords(((item.file, item.address, values),))]
    return [*cell_requests("holding_registers", item.address, values, _function(options))]


def _register(text: str) -> int:
    """Return one register; the error about 1e3 or 1.5 says what to type instead."""
    try:
        return typed_register(text)
    except ValueError as error:
        is_decimal = re.fullmatch(r"[+-]?[0-9]+[.eE][0-9.eE+-]*", text)
        advice = "; type all digits, or a type as in hr 0:float32" if is_decimal else ""
        raise ValueError(f"{error}{advice}") from None


# --- verifying -----------------------------------------------------------------------


def _verified(context: Client, write: Write, differing: list[str]) -> list[int]:
    """Read what was written; return the cells, and add a line for each cell that differs."""
    from ...device.access import touched

    item = write.item
    read: list[int] = []
    for request in write.requests:
        (access,) = touched(request).writes
        values, bits = access.values, 0xFFFF
        if isinstance(request, pdu.MaskWriteRegister):
            # Bits that the AND mask keeps are not known.
            values, bits = (request.or_mask,), ~request.and_mask & 0xFFFF
        if access.table == "file":
            record = access.file, access.address, access.count
            (cells,) = context.execute(pdu.ReadFileRecords((record,)))
        else:
            cells = context.execute(TABLES[access.table].read(access.address, access.count))
        first = access.address - item.address
        name = item.label if item.point is None else f"{item.point.name}, register {{}}".format
        differing += [
            f"{name(first + at)}: wrote {int(value)}, reads {int(cell)}"
            for at, (value, cell) in enumerate(zip(values, cells, strict=False))
            if (int(value) ^ int(cell)) & bits
        ]
        read += [int(cell) for cell in cells[: len(values)]]
    return read
