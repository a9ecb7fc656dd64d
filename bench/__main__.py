"""
Clients and servers of Modbus side by side on this machine: ./run bench

All peers take turns, in another order in each round; printed are the medians over the
rounds. Nobody else should use the machine meanwhile.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from cells import SECTIONS, cells_of
from children import compile_all
from memory import measure_memory
from report import Report, as_json, as_text
from results import Results, run_rounds
from targets import TARGETS, outcome

MEMORY = "memory"
ALL = [*SECTIONS, MEMORY]


def main() -> None:
    options = parse()
    sections = options.only or ALL
    report = measure(sections, *effort(options))
    print(as_text(report))
    if options.json:
        options.json.write_text(json.dumps(as_json(report), indent=1) + "\n")
    if options.picture:
        from picture import draw

        draw(report, options.picture)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="./run bench", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="one short round, to see that it works"
    )
    parser.add_argument(
        "--only", action="append", choices=ALL, metavar="SECTION", help=f"one of {', '.join(ALL)}"
    )
    parser.add_argument("--rounds", type=int, help="rounds (5)")
    parser.add_argument("--seconds", type=float, help="seconds for a cell in each round (1)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw them there, as PNG")
    return parser.parse_args()


def effort(options: argparse.Namespace) -> tuple[int, float]:
    rounds, seconds = (1, 0.2) if options.quick else (5, 1.0)
    return options.rounds or rounds, options.seconds or seconds


def measure(sections: list[str], rounds: int, seconds: float) -> Report:
    results = Results()
    with tempfile.TemporaryDirectory() as folder:
        programs = Path(folder)
        compile_all(programs)
        for section in SECTIONS:
            if section in sections:
                with cells_of(section, programs) as cells:
                    run_rounds(section, cells, rounds, seconds, results)
        memory = measure_memory(programs) if MEMORY in sections else {}
    measured = {key.section for key in results.measured}
    outcomes = [
        outcome(target, results.rate) for target in TARGETS if target.theirs.section in measured
    ]
    return Report(rounds, seconds, results, memory, outcomes)


if __name__ == "__main__":
    main()
