"""
Write the manual page of the command line: python packaging/man.py FILE

Its text is that of --help-all, command by command. It is made when the package is built, and is
the same for each time, because its date is that of SOURCE_DATE_EPOCH, or none.
"""

from __future__ import annotations

import os
import re
import sys
from datetime import UTC, datetime
from pathlib import Path

HEAD = r"""
.SH NAME
{program} \- Modbus clients, servers and tools, based on libmodbus
.SH SYNOPSIS
.B {program}
.I COMMAND
.RI [ ARGUMENTS ]
.SH DESCRIPTION
Addresses count from 0, as in frames; times are in seconds. The commands are:
"""

TAIL = r"""
.SH EXIT STATUS
0 if all worked; 1 if the connection or the device failed, which stderr explains; 2 for wrong usage.
.SH FILES
Completion in bash and zsh needs the package argcomplete (python3\-argcomplete in Debian).
.SH SEE ALSO
.BR mbpoll (1),
.BR libmodbus (7)
"""


def page() -> str:
    """Return the page in the language of man(7)."""
    os.environ["COLUMNS"] = "78"  # argparse breaks lines there
    from libmodbus_py.cli.commands import COMMANDS, PROGRAM, parser_of
    from libmodbus_py.version import __version__

    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    day = datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%d") if epoch else ""
    title = f'.TH {PROGRAM.upper()} 1 "{day}" "{PROGRAM} {__version__}" "User Commands"\n'
    listed = "".join(
        f".TP\n.B {_safe(name)}\n{_safe(about)}\n" for name, (_, about) in COMMANDS.items()
    )
    parsers = {name: parser_of(name) for name in COMMANDS}
    told = "".join(
        f".SH {_safe(name.upper())}\n.EX\n{_safe(parser.format_help(shows_all=True))}.EE\n"
        for name, parser in parsers.items()
    )
    return f"{title}{HEAD.strip().format(program=_safe(PROGRAM))}\n{listed}{told}{TAIL.strip()}\n"


def _safe(text: str) -> str:
    """Return text in which nothing is a request of roff."""
    text = text.replace("\\", r"\e").replace("-", r"\-").replace("'", r"\(aq")
    return re.sub(r"^(?=[.\\])", r"\\&", text, flags=re.MULTILINE)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
