"""What a device has is checked when it is set: by its arguments, and by assignments later."""

from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Point, RegisterMap, pdu
from libmodbus_py.device.functions import ARGUMENTS_ONLY
from libmodbus_py.serve import Hook, RecordFile

WRONG: dict[str, list[tuple[Any, type[Exception], str]]] = {
    "server_id": [
        (
            b"\x01\xff",
            TypeError,
            r'^server_id must be a ServerId, such as ServerId\(b"\\x01", .*\), not bytes$',
        ),
        (("a", True), TypeError, r"^server_id must be a ServerId, .* not tuple$"),
        (pdu.ServerId(b"", True), ValueError, r"^server_id must take 2\.\.251 bytes, not 1$"),
        (pdu.ServerId(bytes(251), True), ValueError, r"^server_id must take .* not 252$"),
        (pdu.ServerId("pump", True), TypeError, r"^server_id.identifier must be bytes, not str$"),  # type: ignore[arg-type]
        (pdu.ServerId(b"a", True, "b"), TypeError, r"^server_id.additional must be bytes"),  # type: ignore[arg-type]
        (pdu.ServerId(b"a", "on"), TypeError, r"^server_id.running must be True, False or None"),  # type: ignore[arg-type]
    ],
    "exception_status": [
        (256, ValueError, r"^exception_status must be in 0\.\.255, not 256$"),
        ("1", TypeError, r"^exception_status must be an integer in 0\.\.255, not str$"),
        (True, TypeError, r"^exception_status must be an integer in 0\.\.255, not True$"),
    ],
    "files": [
        ([1], TypeError, r"^files must be \{file number: records\}, not \[1\]$"),
        ({0: 1}, ValueError, r"^files\[0\] must be in 1\.\.65535, not 0$"),
        ({4: "abc"}, TypeError, r"^files\[4\]\.records must be a number of records"),
        ({4: [65536]}, ValueError, r"^files\[4\]\.value must be in 0\.\.65535, not 65536$"),
    ],
    "fifos": [
        ([1], TypeError, r"^fifos must be \{pointer address: registers\}, not \[1\]$"),
        ({-1: []}, ValueError, r"^fifo must be in 0\.\.65535, not -1$"),
        ({7: 5}, TypeError, r"^fifos\[7\] must be a list of registers, not 5$"),
        ({7: "12"}, TypeError, r"^fifos\[7\] must be a list of registers, not '12'$"),
        ({7: [1, 65536]}, ValueError, r"^fifos\[7\]\[1\] must be in 0\.\.65535, not 65536$"),
        ({7: [1.5]}, TypeError, r"^fifos\[7\]\[0\] must be an integer in 0\.\.65535, not float$"),
    ],
    "mapping": [
        (None, TypeError, r"^mapping must be a Mapping, not NoneType$"),
        ({}, TypeError, r"^mapping must be a Mapping, not dict$"),
    ],
}

CASES = [
    pytest.param(name, *case, id=f"{name}-{number}")
    for name, cases in WRONG.items()
    for number, case in enumerate(cases)
]


@pytest.mark.parametrize(("name", "value", "error", "text"), CASES)
def test_a_wrong_value_is_refused_as_argument_and_attribute(name, value, error, text) -> None:
    with pytest.raises(error, match=text):
        Device(**{"mapping": Mapping(), name: value})
    device = Device(Mapping(holding_registers=1), files={4: 1}, fifos={7: [9]})
    before = getattr(device, name)
    with pytest.raises(error, match=text):
        setattr(device, name, value)
    assert getattr(device, name) is before


@pytest.mark.parametrize("value", [-1, 65536, "1", True, None])
def test_the_diagnostic_register_holds_a_register_value(value: Any) -> None:
    device = Device(Mapping())
    with pytest.raises((TypeError, ValueError), match=r"^diagnostic_register must be "):
        device.diagnostic_register = value
    assert device.answer(bytes.fromhex("08 0002 0000")) == bytes.fromhex("08 0002 0000")


@pytest.mark.parametrize("name", ["handlers", "identification"])
@pytest.mark.parametrize("value", [5, "abc", [1]])
def test_options_of_another_type_than_a_mapping_are_named(name: str, value: Any) -> None:
    with pytest.raises(TypeError, match=rf"^{name} must be \{{.*\}}, not "):
        Device(Mapping(), **{name: value})


@pytest.mark.parametrize("name", sorted(ARGUMENTS_ONLY))
def test_an_argument_that_is_no_attribute_cannot_be_set(name: str) -> None:
    device = Device(Mapping())
    text = rf"^{name} is an argument of Device\(\.\.\.\), and cannot be set$"
    with pytest.raises(AttributeError, match=text):
        setattr(device, name, print)


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (Device(Mapping()), "in_c"),
        (Device(Mapping()), "points"),
        (Device(Mapping()), "has_points"),
        *[(Mapping(), name) for name in ("coils", "holding_registers", "lock")],
        *[(Mapping(), name) for name in ("discrete_inputs", "input_registers")],
        *[(Mapping(coils=1).coils, name) for name in ("name", "ranges", "addresses", "view")],
        *[(Hook(print), name) for name in ("call", "places")],
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_derived_attributes_are_read_only(owner: object, name: str) -> None:
    with pytest.raises(AttributeError, match=name):
        setattr(owner, name, getattr(owner, name))


def test_records_and_queues_are_checked_one_by_one() -> None:
    device = Device(Mapping(), files={4: 2}, fifos={7: [1]})
    changes: list[tuple[Any, Any, Any, str]] = [
        (device.files, 0, [1], r"^files\[0\] must be in 1\.\.65535, not 0$"),
        (device.files, 5, "abc", r"^files\[5\]\.records must be "),
        (device.fifos, 8, [65536], r"^fifos\[8\]\[0\] must be in 0\.\.65535"),
        (device.fifos, 8, None, r"^fifos\[8\] must be a list of registers, not None$"),
        (device.fifos[7], 0, -1, r"^a register must be in 0\.\.65535, not -1$"),
        (device.fifos[7], slice(0, 1), [1, "2"], r"^\[1\] must be an integer in 0\.\.65535"),
    ]
    for owner, key, value, text in changes:
        with pytest.raises((TypeError, ValueError), match=text):
            owner[key] = value
    for change in (
        lambda: device.fifos[7].append(65536),
        lambda: device.fifos[7].extend([2.5]),  # type: ignore[list-item]
        lambda: device.fifos.update({9: [-1]}),  # type: ignore[dict-item]
        lambda: device.fifos.setdefault(9, ["1"]),  # type: ignore[arg-type]
        lambda: device.files.update({70_000: RecordFile(1)}),
    ):
        with pytest.raises((TypeError, ValueError), match="must be"):
            change()
    assert device.fifos == {7: [1]}
    assert {number: list(file) for number, file in device.files.items()} == {4: [0, 0]}


def test_values_set_in_attributes_are_answered() -> None:
    device = Device(Mapping(holding_registers=1))
    file = RecordFile({2: 7})
    device.files = {4: file}  # type: ignore[assignment]
    device.files[5] = [8, 9]  # type: ignore[assignment]
    device.fifos = {1246: [440]}  # type: ignore[assignment]
    device.fifos[1246].append(4740)
    device.server_id = pdu.ServerId(b"pump", True)
    assert device.files[4] is file
    assert device.answer(bytes.fromhex("14 07 06 0004 0002 0001"))[-2:] == b"\0\7"
    assert device.answer(bytes.fromhex("14 07 06 0005 0000 0002"))[-4:] == b"\0\x08\0\x09"
    # The worked example of function 24 (section 6.18).
    answer = bytes.fromhex("18 0006 0002 01B8 1284")
    assert device.answer(bytes.fromhex("18 04DE")) == answer
    assert device.answer(b"\x11") == b"\x11\5pump\xff"
    assert repr(device.fifos[1246]) == "FifoQueue([440, 4740])"


def test_another_mapping_must_contain_all_points() -> None:
    points = RegisterMap([Point("flow", "holding_registers", 5)])
    device = Device(Mapping(holding_registers=6), points=points)
    with pytest.raises(ValueError, match=r"^flow: <holding_registers 0\.\.4> lacks its cells, 5"):
        device.mapping = Mapping(holding_registers=5)
    device.mapping = Mapping(holding_registers={5: [42]})
    assert device["flow"] == 42


def test_hooks_are_called_for_another_mapping() -> None:
    """A hook on all addresses of the first mapping is one on a part of the second."""
    hook = Hook(print, holding_registers=range(4))
    device = Device(Mapping(holding_registers=4), before_read=hook)
    assert 3 not in device.in_c
    device.mapping = Mapping(holding_registers=8)
    assert 3 in device.in_c
