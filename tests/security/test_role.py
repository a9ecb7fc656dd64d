"""Roles in certificates: MB-TCP-Security-v36, R-21, R-22, R-23 and R-65, and X.690 for the DER."""

import subprocess
import sys

import pytest
from cryptography import x509
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.checks import check_certificate, check_role_value
from libmodbus_py.security.certificates import ROLE_OID, RoleError, encode_role, role_of
from libmodbus_py.version import how_to_add
from tests.support import certificates
from tests.support.cases import each_case

# The specification's own example (section 8.4): 0C 08 4F 70 65 72 61 74 6F 72.
OPERATOR = bytes.fromhex("0C 08 4F 70 65 72 61 74 6F 72")


def client(*values: bytes | str) -> bytes:
    return certificates.with_roles(certificates.client(None), *values).der


def test_the_example_of_the_specification() -> None:
    assert role_of(client(OPERATOR)) == "Operator"
    assert encode_role("Operator") == OPERATOR


def test_a_certificate_without_the_extension_has_no_role() -> None:
    assert role_of(client()) is None
    assert role_of(certificates.self_signed().der) is None


@each_case(
    "role",
    ["x", "Operator", "Operator,Engineer", "Prüfer 1", "技術者", "a" * 127, "b" * 128, "c" * 255],
)
def test_the_whole_string_is_one_role(role: str) -> None:
    assert role_of(client(role)) == role
    assert role_of(certificates.client(role).der) == role


@each_case(
    "value",
    [
        b"\x16\x08Operator",  # IA5String
        b"\x13\x08Operator",  # PrintableString
        b"\x04\x0a" + OPERATOR,  # wrapped once more
        b"\x30\x0a" + OPERATOR,  # a sequence
        b"\x2c\x0a" + OPERATOR,  # constructed, as BER may
        b"Operator",
        b"",
        b"\x0c",
        b"\x0c\x09Operator",
        b"\x0c\x07Operator",
        OPERATOR + b"\0",
        OPERATOR + OPERATOR,
        b"\x0c\x81\x08Operator",  # lengths that BER may have
        b"\x0c\x82\x00\x08Operator",
        b"\x0c\x80Operator\0\0",
        b"\x0c\x81",
        b"\x0c\x81" + b"a" * 129,  # 81h is not a length of its own
        b"\x0c\xfd" + b"a" * 253,
        b"\x0c\x81\x80" + b"a" * 127,
        b"\x0c\x82\x01\x00" + b"a" * 256,
        b"\x0c\x08Operato\xff",
        b"\x0c\x02\xc0\x80",  # a NUL in disguise
        b"\x0c\x03\xed\xa0\x80",  # half a pair of UTF-16
        b"\x0c\x00",
        b"\x0c\x09Operator\0",
        b"\x0c\x0aOperator\r\n",
        b"\x0c\x81\xff" + b"\n" * 255,
        b"\x0c\x82\x40\0" + b"a" * 0x4000,
        b"\x1b" * 9999,
    ],
)
def test_an_invalid_role_is_refused_in_one_short_line(value: bytes) -> None:
    with pytest.raises(RoleError, match=r"^the role") as caught:
        role_of(client(value))
    assert len(str(caught.value)) < 200
    assert str(caught.value).isprintable()


def test_two_roles_are_refused() -> None:
    for values in ((OPERATOR, "Engineer"), (OPERATOR, OPERATOR)):
        with pytest.raises(RoleError, match="two roles"):
            role_of(client(*values))


def test_another_extension_twice_is_refused_by_its_name() -> None:
    der = client(OPERATOR, OPERATOR)
    oid = x509.ObjectIdentifier(ROLE_OID)
    other = bytes.fromhex("06 0A 2B 06 01 04 01 83 89 0C 86 22 02")[-4:]
    assert der.count(other[:3] + b"\1") == 2, oid
    with pytest.raises(RoleError, match=r"50316\.802\.2' twice"):
        role_of(der.replace(other[:3] + b"\1", other))


@each_case("data", [b"", b"\0", b"0", b"\x30\x00", b"\x30\x80", OPERATOR, b"a" * 100_000])
def test_invalid_certificates_are_refused(data: bytes) -> None:
    with pytest.raises(RoleError, match="cannot be read"):
        role_of(data)


def test_a_version_that_does_not_exist_is_refused() -> None:
    """The library raises an error of its own, which is no ValueError."""
    third = bytes.fromhex("A0 03 02 01 02")
    der = client(OPERATOR)
    assert der.count(third) == 1
    with pytest.raises(RoleError, match="cannot be read"):
        role_of(der.replace(third, third[:-1] + b"\5"))


@settings(max_examples=200)
@given(st.binary(max_size=300) | st.builds(lambda rest: b"\x0c" + rest, st.binary(max_size=300)))
def test_any_bytes_are_a_valid_role_or_a_role_error(value: bytes) -> None:
    check_role_value(value)


@settings(max_examples=200)
@given(st.text(max_size=300))
def test_an_encoded_role_is_decoded_or_refused(role: str) -> None:
    try:
        value = encode_role(role)
    except RoleError:
        return
    assert check_role_value(value) == role


GOOD = [client(OPERATOR), client(), client("a" * 200), client("Operator", "Engineer")]


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    data = draw(st.sampled_from(GOOD))
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(data) - 1))
        cut = draw(st.integers(0, 3))
        data = data[:at] + draw(st.binary(max_size=3)) + data[at + cut :] or b"0"
    return data


@settings(max_examples=500)
@given(damaged() | st.binary(max_size=200))
def test_any_damaged_certificate_is_a_role_error(data: bytes) -> None:
    check_certificate(data)


def test_without_cryptography_the_error_says_what_to_install() -> None:
    program = (
        "import sys; sys.modules['cryptography'] = None\n"
        "from libmodbus_py.security.certificates import role_of; role_of(b'')"
    )
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert process.returncode == 1
    last = process.stderr.splitlines()[-1]
    assert last.startswith("ImportError: ")
    assert how_to_add("security") in last


def test_cryptography_is_imported_late() -> None:
    program = "import libmodbus_py.cli.main, libmodbus_py.security.certificates, sys\n"
    program += "import libmodbus_py.cli.certificates; print('cryptography' in sys.modules)"
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert process.stdout == "False\n"
