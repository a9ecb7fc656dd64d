"""The frames that pages show are worked examples, and those this package makes."""

import re

from sybil import Document

from libmodbus_py import framing, pdu, values
from tests.docs.documents import ROOT, blocks
from tests.support.cases import each_case
from tests.support.vectors import FRAMES, REFERENCES, FrameVector

PAGES = ROOT / "docs" / "protocol"
LINE = re.compile(
    r"(request|response|exception)\s+(pdu|tcp|rtu|ascii)\s+(:\w+|(?:[0-9A-F]{2}\b ?)+)"
)
ROW = re.compile(r"\| (\d+)(?:/\d+)? \| [^|]+ \| `([0-9A-F ]+)` \| `([0-9A-F ]+)` \|")

ShownTable = tuple[str, str, str]  # kind, form, as it is written


def frames() -> list[ShownTable]:
    rows: list[ShownTable] = []
    for path in sorted(PAGES.glob("*.md")):
        for region in blocks(Document(path.read_text(), str(path))):
            if region.lexemes["language"] == "frame":
                lines = region.lexemes["source"].strip().splitlines()
                rows += [(line[1], line[2], line[3]) for line in map(LINE.match, lines) if line]
                assert len(lines) == len([line for line in lines if LINE.match(line)])
    for row in ROW.finditer((PAGES / "functions.md").read_text()):
        rows += [("request", "pdu", row[2]), ("response", "pdu", row[3])]
    return rows


def as_bytes(form: str, text: str) -> bytes:
    return f"{text}\r\n".encode() if form == "ascii" else bytes.fromhex(text)


def vector(kind: str, form: str, text: str) -> FrameVector:
    data = as_bytes(form, text)
    return next(frame for frame in FRAMES if frame.kind == kind and getattr(frame, form) == data)


@each_case("example", frames(), ids=" ".join)
def test_a_frame_is_a_worked_example(example: ShownTable) -> None:
    assert vector(*example)


@each_case("example", [frame for frame in frames() if frame[1] != "pdu"], ids=" ".join)
def test_the_package_makes_the_same_frame(example: ShownTable) -> None:
    kind, form, text = example
    row = vector(*example)
    role = "server" if kind == "request" else "client"
    framer = framing.make_framer(form, role)  # type: ignore[arg-type]
    frame = row.tcp_frame if form == "tcp" else row.frame
    assert framer.encode(frame) == as_bytes(form, text)
    assert [(frame.unit, frame.pdu) for frame in framer.feed(as_bytes(form, text))] == [
        (row.unit, row.pdu)
    ]


def test_every_function_has_a_row() -> None:
    codes = {int(row[1]) for row in ROW.finditer((PAGES / "functions.md").read_text())}
    assert codes == set(pdu.REQUESTS) - {code for code in pdu.REQUESTS if code >= 65}


def test_references_are_parsed_as_the_page_says() -> None:
    text = (PAGES / "addresses.md").read_text()
    rows = re.findall(r"^\| (\d{5,6}) \| ([\w ]+) \| (\d+) \|", text, re.MULTILINE)
    assert len(rows) >= 8
    for reference, table, address in rows:
        assert values.parse_reference(reference) == (table.replace(" ", "_"), int(address))
    assert {"40108", "40123", "30009", "10102"} <= {reference.reference for reference in REFERENCES}
