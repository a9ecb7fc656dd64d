"""
Passwords in files: two of one path are equal, so that equal outputs are.
"""

from __future__ import annotations

from pathlib import Path

from libmodbus_py.services.fleet.outputs.credentials import SecretFile


def test_passwords_of_one_file_are_equal(tmp_path: Path) -> None:
    one, other = (tmp_path / name for name in ("one", "other"))
    for path in (one, other):
        path.write_text("the same\n")
    assert SecretFile(one) == SecretFile(str(one))
    assert hash(SecretFile(one)) == hash(SecretFile(str(one)))
    assert SecretFile(one) != SecretFile(other)
    assert SecretFile(one) != str(one)
