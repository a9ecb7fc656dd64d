"""
The encodings of text in registers: those of strings, and MAC addresses.
"""

from __future__ import annotations

import re
import reprlib
from encodings import normalize_encoding
from encodings.aliases import aliases

from .mistakes import Path, WrongType, WrongValue

__all__ = ["ENCODINGS", "encoded", "fill_of", "pack_mac", "unpack_mac"]

# fmt: off
ENCODINGS = frozenset((
    "ascii", "latin_1", "utf_8", "utf_16", "utf_16_be", "utf_16_le", "utf_32", "utf_32_be",
    "utf_32_le", "cp1250", "cp1251", "cp1252", "cp1253", "cp1254", "cp1255", "cp1256", "cp1257",
    "cp1258", "cp437", "cp737", "cp775", "cp850", "cp852", "cp855", "cp857", "cp858", "cp860",
    "cp861", "cp862", "cp863", "cp864", "cp865", "cp866", "cp869", "iso8859_2", "iso8859_3",
    "iso8859_4", "iso8859_5", "iso8859_6", "iso8859_7", "iso8859_8", "iso8859_9", "iso8859_10",
    "iso8859_11", "iso8859_13", "iso8859_14", "iso8859_15", "iso8859_16", "koi8_r", "koi8_u",
    "mac_roman", "tis_620", "shift_jis", "cp932", "euc_jp", "gb2312", "gbk", "gb18030", "big5",
    "cp950", "euc_kr", "cp949",
))
# fmt: on
"""
The encodings of strings in registers, by Python's names of their modules. Not all that Python
knows: some take the square of the text's length (punycode), and every other name would import
a module.
"""


def _known_encoding(encoding: str) -> bool:
    # Python drops other characters from the name, though not everywhere; 3.15 warns of them.
    if not (encoding.isascii() and encoding.isprintable()):
        return False
    name = normalize_encoding(encoding.lower())
    return aliases.get(name, name) in ENCODINGS


def encoded(name: str | Path, value: str, encoding: str) -> bytes:
    """Return a text in an encoding. Raises WrongValue for characters that it lacks."""
    try:
        return value.encode(encoding)
    except UnicodeError:
        raise WrongValue(name, f"must be {encoding}, not {reprlib.repr(value)}") from None


def fill_of(padding: str, encoding: str) -> bytes:
    """
    Return the bytes of one more padding: without the mark that begins UTF-16 text.

    Raises:
        WrongType, WrongValue: there is no such encoding, or the padding is not one character of it.
    """
    for name, given in (("encoding", encoding), ("padding", padding)):
        if not isinstance(given, str):
            raise WrongType(name, f"must be a string, not {type(given).__name__}")
    if len(padding) != 1:
        raise WrongValue("padding", f"must be one character, not {reprlib.repr(padding)}")
    if not _known_encoding(encoding):
        raise WrongValue(
            "encoding",
            f"must be ascii, latin-1, utf-8, cp1252 or another of values.ENCODINGS,"
            f" not {reprlib.repr(encoding)}",
        )
    one, two = (encoded("padding", padding * count, encoding) for count in (1, 2))
    return two[len(one) :]


_MAC = re.compile(r"[0-9A-Fa-f]{2}(?:[:-][0-9A-Fa-f]{2}){5}", re.ASCII)


def pack_mac(name: str | Path, value: object) -> bytes:
    """
    Return the eight bytes of a MAC address: two of padding, which are 0, come first.

    Raises:
        WrongType, WrongValue: the value is no text like "0D:D7:4C:C6:44:8E" or "0d-d7-4c-c6-44-8e".
    """
    if not isinstance(value, str):
        raise WrongType(name, f"must be a string, not {type(value).__name__}")
    if not _MAC.fullmatch(value):
        raise WrongValue(name, f"must be like 0D:D7:4C:C6:44:8E, not {reprlib.repr(value)}")
    return bytes.fromhex(f"0000{value.replace(':', '').replace('-', '')}")


def unpack_mac(data: bytes) -> str:
    """Return the MAC address that eight bytes hold; the two of padding may hold anything."""
    return data[2:].hex(":").upper()
