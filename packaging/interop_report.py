"""
Run the interoperability tests and print what works with whom, as a Markdown table.

    python packaging/interop_report.py [options for pytest, such as -n 2]

The table is read off the ids of the tests, and off those that they record for the
cases of their tables (interop.case_id, interop.try_cases). Ends with pytest's exit status.
"""

import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import compress
from pathlib import Path
from xml.etree import ElementTree

TESTS = Path(__file__).parents[1] / "tests"
CASE = re.compile(
    r"(?P<peer>\w+)-(?P<role>client|server)-(?P<transport>[a-z+]+)-fc(?P<function>\d+)(?P<more>.*)$"
)
LINES = {"client": "our client, its server", "server": "its client, our server"}

Row = tuple[str, str, str]  # peer, role, transport


def run(report: Path, options: list[str]) -> int:
    """Run the tests; their own output goes to standard error."""
    files = sorted(TESTS.glob("interop/test_interop_*.py"))
    command = [sys.executable, "-m", "pytest", "-q", *files, f"--junitxml={report}", *options]
    return subprocess.run(command, cwd=TESTS.parent, stdout=sys.stderr).returncode


def status(case: ElementTree.Element) -> str:
    """Return what became of one test."""
    if case.find("failure") is not None or case.find("error") is not None:
        return "failed"
    return "skipped" if case.find("skipped") is not None else "passed"


def named(case: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Yield what became of the cases that a test has recorded, or else of the test itself."""
    recorded = [(one.get("name", ""), one.get("value", "")) for one in case.iter("property")]
    yield from recorded or [(case.get("name", "").partition("[")[2].rstrip("]"), status(case))]


def outcome(status: str, more: str) -> str:
    """Return what one case means for its cell of the table."""
    if status == "failed":
        return "FAIL"
    if status == "skipped":
        return "skipped"
    return next((word for word in ("pinned", "refused") if word in more.split("-")), "ok")


def read(report: Path) -> tuple[dict[Row, dict[int, set[str]]], int]:
    """Return the outcomes of each cell, and how many cases stand behind them."""
    table: dict[Row, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
    count = 0
    for case in ElementTree.parse(report).iter("testcase"):
        for name, became in named(case):
            if found := CASE.match(name):
                row = (found["peer"], found["role"], found["transport"])
                table[row][int(found["function"])].add(outcome(became, found["more"]))
                count += 1
    return table, count


def cell(outcomes: set[str]) -> str:
    """The worst that happened; a refusal only where nothing was granted."""
    for word in ("FAIL", "skipped"):
        if word in outcomes:
            return word
    if "pinned" in outcomes:
        return "ok*" if "ok" in outcomes else "*"
    return "ok" if "ok" in outcomes else "refused" if outcomes else ""


COLUMNS = {"ok": "ok", "ok*": "ok, but the peer errs in some cases", "*": "the peer errs"}
COLUMNS |= {"refused": "refused", "skipped": "skipped", "FAIL": "FAIL"}


def markdown(table: dict[Row, dict[int, set[str]]]) -> str:
    """Return a row for each peer and direction; transports with the same outcomes share one."""
    rows: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for (peer, role, transport), row in sorted(table.items()):
        found = [
            ranges(function for function in sorted(row) if cell(row[function]) == word)
            for word in COLUMNS
        ]
        rows[(peer, LINES[role], *found)].append(transport)
    used = [any(key[2 + at] for key in rows) for at in range(len(COLUMNS))]
    heads = ["peer", "direction", "transport", *compress(COLUMNS.values(), used)]
    lines = [heads, ["---"] * len(heads)]
    for (peer, direction, *cells), transports in rows.items():
        lines.append([peer, direction, ", ".join(transports), *compress(cells, used)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ranges(numbers: Iterable[int]) -> str:
    """Return sorted numbers as text, such as ``1-6, 15``."""
    found: list[list[int]] = []
    for number in numbers:
        if found and found[-1][-1] == number - 1:
            found[-1].append(number)
        else:
            found.append([number])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in found)


def main() -> int:
    with tempfile.TemporaryDirectory() as directory:
        report = Path(directory) / "report.xml"
        status = run(report, sys.argv[1:])
        if not report.exists():
            return status
        table, count = read(report)
    print(markdown(table))
    print()
    print(f"The numbers are function codes, in {count} cases.")
    return status


if __name__ == "__main__":
    sys.exit(main())
