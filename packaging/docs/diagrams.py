"""
Draw the diagrams of the documentation: python packaging/docs/diagrams.py FOLDER

Each NAME.txt of the folder becomes NAME.svg. The text says what stands in columns, from left to
right, and which boxes are connected:

    title: A gateway
    column: client A; client B
    column: gateway / routes, queues
    client A -- gateway: TCP
    client B -- gateway

What follows " / " is a second, smaller line of a box.
"""

from __future__ import annotations

import html
import re
import sys
from dataclasses import dataclass, field
from pathlib import Path

WIDTH, HEIGHT = 176, 46  # of a box
GAP, ROOM, EDGE = 120, 22, 14  # between columns, between boxes, around all

STYLE = (
    "<style>text{font:14px system-ui,sans-serif;fill:#1f2328;text-anchor:middle}"
    ".small{font-size:12px;fill:#59636e}rect{fill:#f6f8fa;stroke:#818b98}"
    ".label{paint-order:stroke;stroke:#fff;stroke-width:5px}"
    "line{stroke:#818b98;stroke-width:1.5}.all{fill:#fff;stroke:none}"
    "@media(prefers-color-scheme:dark){text{fill:#f0f6fc}.small{fill:#9198a1}"
    "rect{fill:#151b23;stroke:#656c76}.all{fill:#0d1117}.label{stroke:#0d1117}}</style>"
)


@dataclass
class Diagram:
    """
    What a text says.

    Attributes:
        columns: of boxes: the name, and the smaller line or "".
        lines: the names of two boxes, and the label or "".
    """

    title: str = ""
    columns: list[list[tuple[str, str]]] = field(default_factory=list)
    lines: list[tuple[str, str, str]] = field(default_factory=list)


def read(text: str) -> Diagram:
    """
    Read a text.

    Raises:
        ValueError: a line says nothing that is known, or names a box that is in no column.
    """
    made = Diagram()
    for line in filter(None, map(str.strip, text.splitlines())):
        if line.startswith("title:"):
            made.title = line.removeprefix("title:").strip()
        elif line.startswith("column:"):
            boxes = line.removeprefix("column:").split(";")
            parts = [box.partition(" / ") for box in boxes]
            made.columns.append([(name.strip(), small.strip()) for name, _, small in parts])
        elif found := re.fullmatch(r"(.+?) -- ([^:]+)(?:: (.+))?", line):
            made.lines.append((found[1], found[2], found[3] or ""))
        else:
            raise ValueError(f"{line!r}: neither a title, nor a column, nor a line")
    names = {name for column in made.columns for name, _ in column}
    for first, second, _ in made.lines:
        if unknown := {first, second} - names:
            raise ValueError(f"{min(unknown)!r} is in no column")
    return made


def drawn(diagram: Diagram) -> str:
    """Return the SVG of a diagram."""
    most = max(map(len, diagram.columns))
    width = len(diagram.columns) * (WIDTH + GAP) - GAP + 2 * EDGE
    height = most * (HEIGHT + ROOM) - ROOM + 2 * EDGE
    places: dict[str, tuple[float, float]] = {}
    boxes = []
    for number, column in enumerate(diagram.columns):
        free = (most - len(column)) * (HEIGHT + ROOM) / 2
        for row, (name, small) in enumerate(column):
            left, top = EDGE + number * (WIDTH + GAP), EDGE + free + row * (HEIGHT + ROOM)
            places[name] = left, top
            boxes += _box(left, top, name, small)
    lines = [part for line in diagram.lines for part in _line(*line, places)]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}"'
            f' width="{width}" role="img">',
            f"<title>{html.escape(diagram.title)}</title>",
            STYLE,
            f'<rect class="all" width="{width}" height="{height}"/>',
            *[*lines, *boxes, "</svg>", ""],
        ]
    )


def _box(left: float, top: float, name: str, small: str) -> list[str]:
    middle = left + WIDTH / 2
    base = top + HEIGHT / 2 + (-2 if small else 5)
    made = [
        f'<rect x="{left}" y="{top:g}" width="{WIDTH}" height="{HEIGHT}" rx="6"/>',
        f'<text x="{middle:g}" y="{base:g}">{html.escape(name)}</text>',
    ]
    if small:
        made.append(
            f'<text class="small" x="{middle:g}" y="{base + 16:g}">{html.escape(small)}</text>'
        )
    return made


def _line(first: str, second: str, label: str, places: dict[str, tuple[float, float]]) -> list[str]:
    (left, top), (right, bottom) = sorted([places[first], places[second]])
    begin, end = (left + WIDTH, top + HEIGHT / 2), (right, bottom + HEIGHT / 2)
    made = [f'<line x1="{begin[0]:g}" y1="{begin[1]:g}" x2="{end[0]:g}" y2="{end[1]:g}"/>']
    if label:
        x, y = (begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2 + (4 if begin[1] != end[1] else -7)
        made.append(f'<text class="small label" x="{x:g}" y="{y:g}">{html.escape(label)}</text>')
    return made


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    for path in sorted(Path(sys.argv[1]).glob("*.txt")):
        path.with_suffix(".svg").write_text(drawn(read(path.read_text())))
