"""
The command line: demo, serve, gateway, read, write, scan, listen, certificates.

Exit code 0; 1 when the device or the line failed; 2 for wrong usage. Errors are
one line on stderr.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from ..protocol.errors import ModbusError
from . import certificates, demo, gateway, listen, read_write, scan, serve

__all__ = ["main"]

PROGRAM = "libmodbus-py"


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command line.

    Args:
        arguments: without the program's name; None for those of the process.

    Returns:
        The exit code.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        code: int = options.run(options)
    except (ModbusError, read_write.UndecodableError, ImportError) as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 1
    except (ValueError, TypeError) as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of our output has gone, as `head` does; nothing is left to say.
        sys.stderr.close()
        return 1
    except OSError as error:
        print(f"{PROGRAM}: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    return code


class _Parser(argparse.ArgumentParser):
    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # argparse's own takes -1e5 and -inf for options.
        self._negative_number_matcher = re.compile(r"-(\.?[0-9]|inf|nan)", re.IGNORECASE)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROGRAM}: {message} (see {PROGRAM} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog=PROGRAM, description="Modbus on libmodbus: try, serve, read, write, listen."
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    command = commands.add_parser("demo", help="watch a client and a server talk on three lines")
    command.set_defaults(run=lambda options: demo.run())
    serve.add_command(commands)
    gateway.add_command(commands)
    read_write.add_commands(commands)
    scan.add_command(commands)
    listen.add_command(commands)
    certificates.add_command(commands)
    return parser
