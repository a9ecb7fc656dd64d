"""
Clients and servers of Modbus side by side on this machine: ./run bench

All peers take turns, in another order in each round; printed are the medians over the
rounds. Nobody else should use the machine meanwhile.

Two states of the package: --before DIR measures both in one run, which is what small
differences want; or --package DIR --save FILE, and later --against FILE. DIR is a checkout
in which ./run demo was run.

--instructions has valgrind count the instructions for one request instead.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from bench import instructions
from bench.cells import SECTIONS, Tools, cells_of
from bench.children import compile_all
from bench.compare import saved, side_by_side, taken_turns
from bench.memory import measure_memory
from bench.report import Report, as_json, as_text
from bench.results import Results, run_rounds
from bench.startup import STARTS, measure_startup
from bench.targets import TARGETS, outcome
from bench.tls import measure_tls

MEMORY, TLS, STARTUP = "memory", "tls", "startup"
ALL = [*SECTIONS, MEMORY, TLS, STARTUP]


def main() -> None:
    options = parse()
    if options.instructions:
        sys.exit(instructions.main(check=options.check, update=options.update))
    sections = options.only or ALL
    earlier = saved(options.against) if options.against else None
    package, before = options.package or sys.executable, options.before or ""
    report = measure(sections, *effort(options), package, before)
    print(as_text(report))
    numbers = as_json(report)
    if before:
        earlier = taken_turns(numbers["cells"])
    if earlier:
        print(f"\n{side_by_side(earlier, numbers['cells'])}")
    if options.save:
        options.save.write_text(json.dumps(numbers, indent=1) + "\n")
    if options.picture:
        from bench.picture import draw

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
    parser.add_argument(
        "--save", type=Path, metavar="FILE", help="write all numbers there, as JSON"
    )
    parser.add_argument(
        "--against", type=Path, metavar="FILE", help="compare with numbers that were saved"
    )
    parser.add_argument(
        "--package",
        type=interpreter,
        metavar="DIR",
        help="measure the package of another checkout",
    )
    parser.add_argument(
        "--before",
        type=interpreter,
        metavar="DIR",
        help="measure the package of another checkout, too, in turns, and compare",
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw them there, as PNG")
    parser.add_argument(
        "--instructions", action="store_true", help="count instructions, with valgrind"
    )
    parser.add_argument(
        "--check", action="store_true", help="... of ours; fail 5 %% above those in the tree"
    )
    parser.add_argument("--update", action="store_true", help="... and write them to the tree")
    options = parser.parse_args()
    if not options.instructions and (options.check or options.update):
        parser.error("--check and --update belong to --instructions")
    return options


def interpreter(checkout: str) -> str:
    found = Path(checkout).absolute() / ".venv/bin/python"
    if not found.exists():
        raise argparse.ArgumentTypeError(f"no {found}: ./run demo there makes it")
    return str(found)


def effort(options: argparse.Namespace) -> tuple[int, float]:
    rounds, seconds = (1, 0.2) if options.quick else (5, 1.0)
    return options.rounds or rounds, options.seconds or seconds


def measure(sections: list[str], rounds: int, seconds: float, package: str, before: str) -> Report:
    results = Results()
    with tempfile.TemporaryDirectory() as folder:
        tools = Tools(Path(folder), package, before)
        compile_all(tools.programs)
        for section in SECTIONS:
            if section in sections:
                with cells_of(section, tools) as cells:
                    run_rounds(section, cells, rounds, seconds, results)
        memory = measure_memory(tools) if MEMORY in sections else {}
        tls = measure_tls(Path(folder), package, rounds, seconds) if TLS in sections else None
        starts = STARTS if rounds > 1 else 1
        startup = measure_startup(tools, starts) if STARTUP in sections else {}
    measured = {key.section for key in results.measured}
    outcomes = [
        outcome(target, results.rate) for target in TARGETS if target.theirs.section in measured
    ]
    return Report(rounds, seconds, results, memory, tls, startup, outcomes)


if __name__ == "__main__":
    main()
