"""
What commands print, compared with golden files: a session of each, as one would see it.

Ports, times and durations are not the same each time, and are replaced.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.commands import Started, ended, run
from tests.support.golden import Golden

MAP = """name,table,address,type,scale,unit,minimum,maximum
level,holding,0,uint16,0.1,mm,,
pump,coils,1,,,,,
setpoint,holding,4,float32,,C,0,90
"""

FLEET = """
[[device]]
name = "one"
url = "{url}"
unit = 7
map = "meter.csv"
"""

SESSIONS = {
    "read": """
        read URL holding 0 3
        read URL holding 0 2 coils 0 3 input 0
        read URL 40001 3 --hex
        read URL holding 0 2 --type int16 --csv
        read URL holding 4 --type float32 --json
        read URL holding 0 2 coils 0 3 --json
        read URL holding 0 2 --type all
        read URL --map FOLDER/meter.csv
        read URL --map FOLDER/meter.csv level setpoint --json
        read URL file:4 0 2
        read URL holding 0 1 holding 9 1
        read URL holding 9
        read URL holding 65536
        read URL holdings 0
    """,
    "write": """
        write URL holding 0 -1 0x10 --dry-run
        write URL holding 4 3.5 --type float32 --order CDAB --dry-run
        write URL --map FOLDER/meter.csv setpoint 21.5 pump on --dry-run
        write URL holding 4 --mask 0xF2 0x25 --dry-run
        write ascii:///dev/ttyUSB0 -u 7 coils 1 on off --dry-run
        write URL holding 0 789 --and-read 0 2
        write URL holding 0 555
        write URL --map FOLDER/meter.csv setpoint 215
        write URL input 0 1
    """,
    "identify": """
        identify URL
        identify URL --level 0 --json
        identify URL -u 9
        diagnose URL return-query-data 0x1234
        diagnose URL 0 7 --json
        diagnose URL nonsense
        raw URL 3 0000 0002
        raw URL 100
        raw URL 3 xyz
    """,
    "scan": """
        scan URL --units 7,9 --timeout 5
        scan URL --units 7 --json --timeout 5
        scan URL --units 9 --timeout 5
        scan URL --units 9-7
        map check FOLDER/meter.csv
        map check FOLDER/wrong.csv
    """,
    "poll": """
        poll FOLDER/fleet.toml --once --csv
        poll FOLDER/fleet.toml --once --json
        poll FOLDER/fleet.toml --check
        poll FOLDER/fleet.toml --once --check
    """,
}


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    registers = {0: [555, 65535, 3, 0, 0x41AC, 0]}
    mapping = Mapping(
        coils={0: [True, False, True]}, holding_registers=registers, input_registers={0: [7]}
    )
    device = Device(
        mapping, files={4: [1, 2, 3]}, identification={0: b"Maker", 1: b"M1", 2: b"1.0"}
    )
    with Server({7: device}).background("tcp://127.0.0.1:0") as running:
        (tmp_path / "meter.csv").write_text(MAP)
        (tmp_path / "wrong.csv").write_text(
            MAP.replace("coils,1", "relays,1").replace("uint16", "uint17")
        )
        (tmp_path / "fleet.toml").write_text(FLEET.format(url=running.urls[0]))
        yield f"{running.urls[0]}?unit=7"


def stable(text: str) -> str:
    """Replace what is not the same in each run."""
    text = re.sub(r"127\.0\.0\.1:[0-9]+", "127.0.0.1:PORT", text)
    text = re.sub(r"20[0-9-]+T[0-9:.]+(Z|[+-][0-9:]+)", "TIME", text)
    text = re.sub(r" *\b[0-9.]+ (min|s|ms)\b(?! of)", " DURATION", text)
    return re.sub(r'"took": [0-9.]+', '"took": DURATION', text)


@pytest.mark.parametrize("name", SESSIONS)
def test_a_session_is_the_golden_file(name: str, url: str, tmp_path: Path, golden: Golden) -> None:
    lines = []
    for command in filter(None, map(str.strip, SESSIONS[name].splitlines())):
        lines.append(f"$ libmodbus-py {command}")
        words = [word.replace("FOLDER", str(tmp_path)) for word in command.split()]
        # Readings go to the descriptor of the standard output: poll needs a process.
        call = ended if name == "poll" else run
        done = call(*(url if word == "URL" else word for word in words))
        lines += [done.out.rstrip("\n")] if done.out else []
        lines += [f"stderr: {line}" for line in done.err.splitlines()]
        lines += [f"exit code {done.code}"] if done.code else []
    golden(f"session_{name}.txt", stable("\n".join(lines)).replace(str(tmp_path), "FOLDER") + "\n")


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("serve", ["tcp://0.0.0.0:0", "udp://127.0.0.1:0", "--own-unit", "7"]),
        ("gateway", ["tcp://127.0.0.1:0", "--to", "7=URL"]),
    ],
)
def test_a_server_announces_itself(
    name: str, arguments: list[str], url: str, tmp_path: Path, golden: Golden
) -> None:
    device = tmp_path / "device.toml"
    device.write_text("".join(f"[[unit]]\nid = {unit}\n" for unit in (7, 8)))
    to = url.partition("?")[0]
    words = [word.replace("URL", to) for word in arguments]
    words += ["--device", str(device)] if name == "serve" else []
    with Started(name, *words) as process:
        lines = [process.stdout.readline() for word in arguments if word.endswith(":0")]
        process.terminate()
        out, error = process.communicate()
    lines += [out, *(f"stderr: {line}\n" for line in error.splitlines())]
    text = re.sub(r":[0-9]{4,5}\b", ":PORT", "".join(lines))
    golden(f"session_{name}.txt", f"$ libmodbus-py {name} {' '.join(arguments)}\n{text}")
    assert process.returncode == 0
