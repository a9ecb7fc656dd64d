"""
One target under atheris: python -m fuzz.guided TARGET [libFuzzer options] [directory or file]

A file, such as a finding, is run once.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["libmodbus_py"]):
    from fuzz.inputs import TARGETS


def main() -> None:
    check = TARGETS[sys.argv.pop(1)].check
    assert check is not None
    atheris.Setup(sys.argv, check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
