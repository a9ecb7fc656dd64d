"""
What commands print, compared with golden files: sessions as one would see them, with the standard
error and exit codes other than 0. Lines that begin with # say what the commands behind them show.
What is typed is read from these files, too: a new line that begins with $ is a new test, and
`./run test --make-golden tests/cli` writes below it what was printed.

Ports, times and durations are not the same each time, and are replaced.
"""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server, pdu
from tests.cli.serving import METER, meter
from tests.support.commands import Started, run, run_forked
from tests.support.golden import Golden
from tests.support.sunspec import chain

TANK = """name,table,address,type,scale,unit,minimum,maximum
level,holding,0,uint16,0.1,mm,,
pump,coils,1,,,,,
setpoint,holding,4,float32,,C,0,90
"""

MEANING = """name,table,address,type,scale_from,unit,states,bits,missing
v,holding,0,int16,v_sf,V,,,
v_sf,holding,1,int16,,,,,
state,holding,2,,,,0 = off; 1 = on,,
flags,holding,3,,,,,0 = door; 4..7 = mode,
at,holding,4,unix32,,,,,
none,holding,6,,,,,,0
"""

BITS = """name,table,address,type,count,bits,bit
pump,coils,5,,,,
valves,discrete_inputs,0,,2,,
ready,holding_registers,0,uint16,,,0
alarm,holding_registers,0,uint16,,,1
flags,holding_registers,0,uint16,,3=hot; 2=cold,
"""

COLUMNS = """Register;Parameter;Data Type;R/W;Multiplier;Vendor's
40001;volts;U16;R;0.1;x
40002;power;S32;RO;1;
40003;setpoint;INT16;R/W;0.1;
40010;serial;string:10;R;;
00001;run;bool;W;;
"""

FLEET = """
[[device]]
name = "one"
url = "{url}"
unit = {unit}
map = "{map}.csv"
"""

IRRADIANCE = chain([302, 5, 812, 0xFFFF, 90, 0xFFFF, 0xFFFF])
"""The registers of a SunSpec model, three of whose points have no value."""

GOLDEN = Path(__file__).with_name("golden")

SESSIONS = sorted(path.stem for path in GOLDEN.glob("session_*.txt"))

PROMPT = "$ libmodbus-py "


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    registers = {0: [555, 65535, 3, 0, 0x41AC, 0]}
    mapping = Mapping(
        coils={0: [True, False, True]}, holding_registers=registers, input_registers={0: [7]}
    )
    devices = {
        1: meter(),  # of METER
        # of MEANING, BITS and TANK
        2: Device(Mapping(holding_registers={0: [2305, 0xFFFF, 1, 0x51, 0, 60, 0]})),
        3: Device(
            Mapping(coils={5: [1]}, discrete_inputs={0: [0, 1]}, holding_registers={0: [0b1001]})
        ),
        7: Device(mapping, files={4: [1, 2, 3]}, identification={0: b"Maker", 1: b"M1", 2: b"1.0"}),
        # without a register 2
        4: Device(Mapping(holding_registers={0: [10, 11], 3: [13]}, input_registers={0: [20]})),
        # of zeros, to write to
        20: Device(
            Mapping(coils=100, holding_registers=2000), files={4: [0] * 10000, 5: [0] * 10000}
        ),
    }
    for unit in (11, 12, 17):
        devices[unit] = Device(
            Mapping(holding_registers={0: [unit, 0]}), identification={"VendorName": f"ACME {unit}"}
        )
    devices[12].server_id = pdu.ServerId(b"A", None, b"CME")
    for unit, cells in ((30, IRRADIANCE), (31, IRRADIANCE[:-2])):
        devices[unit] = Device(Mapping(holding_registers={40000: cells}))
    files = {"tank": TANK, "meter": METER, "meaning": MEANING, "bits": BITS}
    files["wrong"] = TANK.replace("coils,1", "relays,1").replace("uint16", "uint17")
    files["columns"], files["bad"] = COLUMNS, "name,addr\n" + "a,x\n" * 30
    points = (f"p{at},holding_registers,{at},uint16\n" for at in range(4))
    files["points"] = f"name,table,address,type\n{''.join(points)}"
    rows = (f"p{at},holding,{at},{'true' * (at == 2)}\n" for at in range(4))
    files["borders"] = f"name,table,address,border\n{''.join(rows)}"
    files["refused"] = f"{files['points']}other,input_registers,0,uint16\n"
    for name, text in files.items():
        (tmp_path / f"{name}.csv").write_text(text)
    german = "Zähler;;\nBezeichnung;Register;Datentyp\nSpannung;40001;U16\n"
    (tmp_path / "german.csv").write_bytes(german.encode("cp1252"))
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        for unit, name in ((7, "tank"), (3, "bits")):
            text = FLEET.format(url=running.urls[0], unit=unit, map=name)
            (tmp_path / f"{name}.toml").write_text(text)
        yield f"{running.urls[0]}?unit=7"


def stable(text: str) -> str:
    """Replace the parts that differ in each run."""
    text = re.sub(r"127\.0\.0\.1:[0-9]+", "127.0.0.1:PORT", text)
    text = re.sub(r"20\d\d-\d\d-\d\dT[\d:]{8}\.\d{3}Z|[\d:]{8}\.\d{3}(?= [<>] )", "TIME", text)
    text = re.sub(r" *\b[0-9.]+ (min|s|ms)\b(?! of)", " DURATION", text)
    return re.sub(r'"took": [0-9.]+', '"took": DURATION', text)


@pytest.mark.parametrize("name", SESSIONS)
def test_a_session_is_the_golden_file(name: str, url: str, tmp_path: Path, golden: Golden) -> None:
    lines = []
    for line in (GOLDEN / f"{name}.txt").read_text().splitlines():
        if line.startswith((PROMPT, "#")):
            lines.append(line)
        if line.startswith(PROMPT):
            lines += lines_of(line.removeprefix(PROMPT), url, tmp_path)
    golden(f"{name}.txt", "\n".join(lines) + "\n")


def lines_of(command: str, url: str, folder: Path) -> list[str]:
    """Return the lines that a session has below a command."""
    typed = {"URL": url, "HOST": url.partition("?")[0]}
    words = [word.replace("FOLDER", str(folder)) for word in shlex.split(command)]
    # Readings go to the descriptor of the standard output: poll needs a process.
    call = run_forked if words[0] == "poll" else run
    result = call(*(typed.get(word, word) for word in words))
    lines = [result.out.rstrip("\n")] if result.out else []
    lines += [f"stderr: {line}" for line in result.err.splitlines()]
    lines += [f"exit code {result.code}"] if result.code else []
    return [stable(line).replace(str(folder), "FOLDER") for line in lines]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("serve", ["tcp://0.0.0.0:0", "udp://127.0.0.1:0", "--own-unit", "7"]),
        ("gateway", ["tcp://127.0.0.1:0", "--to", "7=URL"]),
    ],
)
def test_a_server_prints_its_url(name, arguments, url: str, tmp_path, golden: Golden) -> None:
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
    golden(f"start_{name}.txt", f"{PROMPT}{name} {' '.join(arguments)}\n{text}")
    assert process.returncode == 0
