"""
Draw what a command shows in a terminal: python packaging/docs/terminal.py FILE SECONDS COMMAND

The command runs in a pseudo-terminal of 92 columns for so many seconds, and what it shows then
becomes a picture (SVG) of text, which any editor can change and any browser can search. That of
README.md is docs/watch.svg, of 8 s of this command while `serve --example meter` runs there:

    libmodbus-py read tcp://127.0.0.1:1502 --map meter --watch 1
"""

from __future__ import annotations

import contextlib
import html
import os
import pty
import re
import select
import shlex
import signal
import struct
import sys
import termios
import time
from fcntl import ioctl
from pathlib import Path

COLUMNS, LINES = 92, 24
WIDTH, HEIGHT, EDGE = 8.4, 19, 16  # of a character, of a line, and around all

COLOURS = {
    "1": 'font-weight="bold"',
    "2": 'opacity="0.6"',
    "31": 'fill="#ff7b72"',
    "32": 'fill="#7ee787"',
    "33": 'fill="#e3b341"',
    "34": 'fill="#79c0ff"',
    "36": 'fill="#76e3ea"',
}

_PART = re.compile(r"\x1b\[([?0-9;]*)([A-Za-z])|([\r\n\b])|([^\x1b\r\n\b]+)")


class Screen:
    """The cells of a terminal: characters, and the look of each."""

    def __init__(self) -> None:
        self.rows: list[list[tuple[str, str]]] = [[]]
        self._row = self._column = 0
        self._look = ""

    def show(self, text: str) -> None:
        """Do what a program wrote to the terminal."""
        for numbers, order, control, plain in _PART.findall(text):
            if order:
                self._obey(order, numbers)
            elif control:
                self._row += control == "\n"
                self._column = 0 if control == "\r" else self._column - (control == "\b")
            for character in plain:
                row = self._at(self._row)
                row.extend([(" ", "")] * (self._column + 1 - len(row)))
                row[self._column] = (character, self._look)
                self._column += 1

    def _obey(self, order: str, numbers: str) -> None:
        count = int(numbers) if numbers.isdigit() else 1
        if order == "m":
            self._look = next((COLOURS[word] for word in numbers.split(";") if word in COLOURS), "")
        elif order == "A":
            self._row = max(0, self._row - count)
        elif order in "HJ":
            self._row, self._column = (0, 0) if order == "H" else (self._row, self._column)
            del self._at(self._row)[self._column :]
            del self.rows[self._row + 1 :]
        elif order == "K":
            del self._at(self._row)[self._column :]

    def _at(self, row: int) -> list[tuple[str, str]]:
        while len(self.rows) <= row:
            self.rows.append([])
        return self.rows[row]


def recorded(command: list[str], seconds: float) -> Screen:
    """Return what a command shows after some seconds, and end it."""
    screen = Screen()
    process, far = pty.fork()
    if process == 0:
        os.environ |= {"TERM": "xterm", "COLUMNS": str(COLUMNS), "LINES": str(LINES)}
        os.execvp(command[0], command)
    ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", LINES, COLUMNS, 0, 0))
    end = time.monotonic() + seconds
    with contextlib.suppress(OSError):  # the command has ended
        while (left := end - time.monotonic()) > 0:
            if select.select([far], [], [], left)[0]:
                screen.show(os.read(far, 65536).decode())
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    os.close(far)
    return screen


def picture(typed: str, screen: Screen) -> str:
    """Return the SVG of a command as it is typed, and of what it shows."""
    prompt = [("$", COLOURS["32"]), (" ", ""), *((entry, "") for entry in typed)]
    rows = [prompt, *screen.rows]
    while not rows[-1]:
        rows.pop()
    width, height = COLUMNS * WIDTH + 2 * EDGE, len(rows) * HEIGHT + 2 * EDGE
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height}" role="img">',
        f"<title>{html.escape(typed)}</title>",
        f'<rect width="{width:.0f}" height="{height}" rx="8" fill="#161b22"/>',
        '<g font-family="ui-monospace, DejaVu Sans Mono, Menlo, monospace" font-size="14"'
        ' fill="#e6edf3">',
    ]
    for number, row in enumerate(rows):
        top = EDGE + HEIGHT * number + 14
        for found in re.finditer(r"\S+(?: \S+)*", "".join(entry for entry, _ in row)):
            lines += _spans(row, found.start(), found.end(), top)
    return "\n".join([*lines, "</g>", "</svg>", ""])


def _spans(row: list[tuple[str, str]], begin: int, end: int, top: int) -> list[str]:
    made = []
    while begin < end:
        look = row[begin][1]
        stop = begin
        while stop < end and row[stop][1] == look:
            stop += 1
        text = html.escape("".join(entry for entry, _ in row[begin:stop]))
        place = (
            f'x="{EDGE + begin * WIDTH:.1f}" y="{top}" textLength="{(stop - begin) * WIDTH:.1f}"'
        )
        made.append(f'<text {place} xml:space="preserve"{" " if look else ""}{look}>{text}</text>')
        begin = stop
    return made


if __name__ == "__main__":
    if len(sys.argv) != 4:
        raise SystemExit(__doc__)
    file, seconds, typed = sys.argv[1:]
    Path(file).write_text(picture(typed, recorded(shlex.split(typed), float(seconds))))
