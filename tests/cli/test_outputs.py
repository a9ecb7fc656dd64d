"""
What commands print, compared with golden files: sessions as one would see them, with the standard
error and exit codes other than 0. Lines that begin with # say what the commands behind them show.

Ports, times and durations are not the same each time, and are replaced.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server, pdu
from tests.cli.serving import METER, meter
from tests.support.commands import Started, ended, run
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

COLUMNS = """Register;Parameter;Data Type;R/W;Factor;Vendor's
40001;volts;U16;R;0.1;x
40002;power;S32;RO;1;
40003;setpoint;INT16;R/W;0.1;
40010;serial;STR10;R;;
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

SESSIONS = {
    "read": """
        read URL holding 0 3
        read URL holding 0 2 coils 0 3 input 0
        read URL 40001 3 --hex
        read URL holding 0 2 --type int16 --csv
        read URL holding 4 --type float32 --json
        read URL holding 0 2 coils 0 3 --json
        read URL holding 0 2 --type all
        read URL --map FOLDER/tank.csv
        read URL --map FOLDER/tank.csv level setpoint --json
        read URL file:4 0 2
        read URL holding 0 1 holding 9 1
        read URL holding 9
        read URL holding 65536
        read URL holdings 0
    """,
    "write": """
        write URL holding 0 -1 0x10 --dry-run
        write URL holding 4 3.5 --type float32 --order CDAB --dry-run
        write URL --map FOLDER/tank.csv setpoint 21.5 pump on --dry-run
        write URL holding 4 --mask 0xF2 0x25 --dry-run
        write ascii:///dev/ttyUSB0 -u 7 coils 1 on off --dry-run
        write 127.0.0.1:1 -u 7 holding 1 3 --dry-run
        write rtu:///dev/none holding 1 3 --dry-run
        write URL holding 0 789 --and-read 0 2
        write URL holding 1 77 --and-read 1 2 --count-from-1
        write URL holding 0 555
        write URL --map FOLDER/tank.csv setpoint 215
        write URL input 0 1
        # what is carried out before a write that fails
        write URL holding 0 7 coils 1 1 holding 9999 1
        read URL holding 0
        write URL holding 9999 1
        # what was stored is read back
        write HOST -u 20 hr 0 5 6 7 co 3 on coils 7 1 0 1 --verify
        write HOST -u 20 hr 0 5 --multiple co 1 on --verify
        write HOST -u 20 hr 0 -1 --verify
        write HOST -u 20 hr 10 3.5 --type float32 --order CDAB --verify
        write HOST -u 20 hr 3 --mask 0xFF00 0x0012 --verify
        write HOST -u 20 hr 3 1 2 --and-read 0 4 --verify
        write HOST -u 20 file:4 3 8 9 --verify
        write HOST -u 20 40123 7 --verify
        write HOST -u 20 hr 7 1 --count-from-1 --verify
    """,
    "identify": """
        identify URL
        identify URL --level 0 --json
        identify URL -u 9
        identify URL --level all
        # a server id without a run indicator
        identify HOST -u 12 --level 0
        identify HOST -u 12 --level 0 --json
        diagnose URL
        diagnose URL 99
        diagnose URL return-query-data 0x1234
        diagnose URL 0 7 --json
        diagnose URL nonsense
    """,
    "scan": """
        scan URL --units 7,9 --timeout 5
        scan URL --units 7 --json --timeout 5
        scan URL --units 9 --timeout 5
        scan URL --units 9 --json --timeout 5
        scan URL --units 9-7
        map check FOLDER/tank.csv
        map check FOLDER/wrong.csv
    """,
    "poll": """
        poll FOLDER/tank.toml --once --csv
        poll FOLDER/tank.toml --once --json
        poll FOLDER/tank.toml --check
        poll FOLDER/tank.toml --once --check
    """,
    "items": """
        read HOST holding 0 2
        read HOST holding 0 2 coils 5 file:4 0 2
        read HOST 40001 40502 2
        read HOST holding 0x1F4
        read HOST holding 0 4 --hex
        read HOST coils 5 --hex
        read HOST --count-from-1 holding 1 2
        read HOST --count-from-1 40001
        read HOST fifo 40
        # a type for all items, and options of it
        read HOST holding 0 --type int16 --order BADC 2
        read HOST holding 20 --type string:4 --encoding utf-8
        read HOST holding 20 --type string:4 --padding d
        read HOST file:4 0 --type uint32
        # every interpretation
        read HOST hr 0 --type all
        read HOST hr 0 4 --type all
        read HOST 30011 3 --type all
        # a type for one item
        read HOST hr 0:int16 3
        read HOST HR 3:int16 hr 3
        read HOST hr 20:string4
        read HOST hr 0:bits16
        read HOST hr 2:int32 hr 0 --order CDAB
        # ranges
        read HOST hr 0-2
        read HOST hr 0-3:uint32 40001-40002
        read HOST 40501-40502:int16
        # JSON and CSV
        read HOST holding 0 3 --json
        read HOST coils 5 --json
        read HOST coils 5 fifo 40 --json
        read HOST holding 20 --type string:4 --json
        read HOST file:4 0 2 --type all --json
        read HOST holding 0 2 coils 5 --csv
        # what JSON printed can be typed
        read HOST 4x 0 --type U16 --order abcd --json
        read HOST holding_registers 0 --type uint16 --order ABCD --json
        # an item that is refused does not hinder the others
        read HOST holding 0 holding 5000 input 0
        read HOST holding 0 holding 5000 --json
        read HOST holding 0 coils 900 --csv
        # references that are typed as addresses
        read HOST holding 40101
        read HOST holding 40101 input 0
        read HOST coils 40101
        # names of a map
        read HOST --map FOLDER/meter.csv voltage pump label
        read --map FOLDER/meter.csv HOST phases holding 0
        read HOST --map FOLDER/meter.csv --json
        read HOST --map FOLDER/meter.csv --csv
    """,
    "types": """
        write HOST -u 20 holding 100 789 12345 -567
        read HOST -u 20 holding 100 3
        write HOST -u 20 40201 0xFFFF
        read HOST -u 20 40201
        write HOST -u 20 coils 10 1 off true
        read HOST -u 20 coils 10 3
        write HOST -u 20 file:4 9998 1 2
        read HOST -u 20 file:4 9998 2
        # numbers
        write HOST -u 20 hr 1000 3.14 -1e5 -inf nan 1e8 --type float32 --order CDAB
        read HOST -u 20 hr 1000 5 --type float32 --order CDAB
        write HOST -u 20 41101 -2 --type int32
        read HOST -u 20 41101 --type int32
        write HOST -u 20 hr 1110 -32768 0x7f --type int16
        read HOST -u 20 hr 1110 2 --type int16
        write HOST -u 20 401121 5 --type uint64 --order hgfedcba
        read HOST -u 20 401121 --type uint64 --order hgfedcba
        write HOST -u 20 hr 1130 0.1 --type float16
        read HOST -u 20 hr 1130 --type float16
        write HOST -u 20 hr 1140 0.1 1e22 --type float64
        read HOST -u 20 hr 1140 2 --type float64
        write HOST -u 20 hr 1150 3.4028235e38 --type float32
        read HOST -u 20 hr 1150 --type float32
        write HOST -u 20 hr 1160 1234 --type bcd32 --order BADC
        read HOST -u 20 hr 1160 --type bcd32 --order BADC
        write HOST -u 20 file:4 9990 0.5 2 --type float32
        read HOST -u 20 file:4 9990 2 --type float32
        write HOST -u 20 file:5 0 -1 --type int64 --order DCBA
        read HOST -u 20 file:5 0 --type int64 --order DCBA
        # bits and texts
        write HOST -u 20 hr 1170 1000000000000001 --type bits16
        read HOST -u 20 hr 1170 --type bits16
        write HOST -u 20 hr 1180 abc 'a b c' --type string:5
        read HOST -u 20 hr 1180 2 --type string:5
        write HOST -u 20 --type string:4 -- hr 1210 -abc
        read HOST -u 20 hr 1210 --type string:4
        # every NaN, and the largest numbers
        write HOST -u 20 hr 0 0xffc0 0 0xffff 0xffff 0xff7f 0xffff
        read HOST -u 20 hr 0 3 --type float32
        write HOST -u 20 hr 0 0x7bff
        read HOST -u 20 hr 0 --type float16
        write HOST -u 20 hr 0 0x7fef 0xffff 0xffff 0xffff
        read HOST -u 20 hr 0 --type float64
        # JSON has null where it has no number
        write HOST -u 20 hr 0 0.1 nan -inf --type float32 --order dcba
        read HOST -u 20 hr 0 3 --type float32 --order dcba --json
        write HOST -u 20 hr 0 18446744073709551615 --type uint64
        read HOST -u 20 hr 0 --type uint64 --json
        read HOST -u 20 hr 0 --type bits16 --json
        # registers that have no such value
        write HOST -u 20 hr 1500 0x0001 0xffff 0xffff
        read HOST -u 20 hr 1500 2 --type bcd16
        read HOST -u 20 hr 1500 1 --type string:6 --json
        read HOST -u 20 hr 1500 3 --type all
        # control characters of a device
        write HOST -u 20 hr 1220 0x1b5b 0x0a41
        read HOST -u 20 hr 1220 --type string:4
        read HOST -u 20 hr 1220 2 --type all
    """,
    "meaning": """
        read HOST -u 2 --map FOLDER/meaning.csv
        read HOST -u 2 --map FOLDER/meaning.csv --json
        read HOST -u 2 --map FOLDER/meaning.csv --csv
        write HOST -u 2 --map FOLDER/meaning.csv v 12.5 state off flags mode=7
        write HOST -u 2 --map FOLDER/meaning.csv at 1970-01-01T00:02:00Z
        read HOST -u 2 hr 0 7
        # a scale that makes no sense
        write HOST -u 2 hr 1 300
        read HOST -u 2 v --map FOLDER/meaning.csv --json
        write HOST -u 2 v 1 --map FOLDER/meaning.csv --dry-run
        # bits: true and false with a name or a type, 0 and 1 in cells of a table, in text and CSV
        read HOST -u 3 --map FOLDER/bits.csv
        read HOST -u 3 --map FOLDER/bits.csv --json
        read HOST -u 3 --map FOLDER/bits.csv --csv
        read HOST -u 3 coils 5 --json
        read HOST -u 3 discrete 1 --json
        read HOST -u 3 holding 0 --type bits16 --json
        poll FOLDER/bits.toml --once
    """,
    "maps": """
        map check FOLDER/columns.csv
        map check FOLDER/bad.csv nothing.csv FOLDER/tank.csv
        map check sdm120
        map list --search EASTRON single
        map list --search heat pumps
        map list --search eastron toaster
        map class sdm120 -o FOLDER/sdm120.py
        map class sdm120 -o FOLDER/sdm120.py
        # unit 1 has all points, 11 lacks some, and 30 has none
        map check FOLDER/points.csv --device HOST
        map check FOLDER/points.csv --device HOST -u 11
        map check FOLDER/points.csv --device HOST -u 30
        # headings of columns
        map check FOLDER/german.csv
        map check FOLDER/german.csv --column name=Bezeichnung --column type=Datentyp
        map class FOLDER/german.csv --column name=Bezeichnung -o FOLDER/german.py
        read HOST --map FOLDER/german.csv --column name=Bezeichnung --column type=Datentyp
        write HOST --map FOLDER/german.csv --column name=Bezeichnung Spannung=8
        read HOST 40001
    """,
    "units": """
        read HOST -u 11-12,17 hr 0
        read HOST -u 11-12,17 hr 0 2
        # unit 13 does not answer
        read HOST -u 12,13,17 hr 0
        read HOST -u 12,13 hr 0 --json
        read HOST -u 12,13 hr 0 --csv
        read HOST -u 11,17 hr 0 --watch 0.01 --count 2
        read HOST -u 11 hr 0 co 0 --watch 0.01 --count 2 --csv
        read HOST -u 11 hr 0 co 0 --watch 0.01 --count 2 --json
        read HOST -u 13 hr 0 --watch 0.01 --count 2
        identify HOST -u 11-12,17 --level 0
        identify HOST -u 12,13,17 --level 0
        diagnose HOST return-query-data 7 -u 11,13,17
        diagnose HOST 0 7 -u 11,13 --json
        identify HOST -u 13-14 --json
    """,
    "sunspec": """
        sunspec HOST -u 30
        sunspec HOST -u 30 --json
        sunspec HOST -u 30 --csv
        # the chain of unit 31 has no end, unit 11 has no models
        sunspec HOST -u 30,31 --csv
        sunspec HOST -u 31,11 --json
        sunspec HOST -u 11,31
        sunspec HOST -u 11
        sunspec HOST -u 30 --base 70000
    """,
    "raw": """
        raw HOST 3 0000 0002
        raw HOST 03 00 00 00 02
        raw HOST 0x10 00 05 00 01 02 00 07
        raw HOST 7
        raw URL 0x2B 0E0100
        raw HOST 100 00
        raw HOST 43 0D0102
        raw HOST 3 1388 0001
        # how words may be written
        raw HOST 0x03 00 00 00 02
        raw HOST 3 00000002
        raw HOST 3 "00 00 00 02"
        raw HOST 3 0x00000002
        raw HOST 3 0x00,0x00, 0x00,02
        raw HOST 3 00:00 0X0002
        raw HOST 3 0000,0002,
    """,
}


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
        # of zeros, to write to
        20: Device(
            Mapping(coils=100, holding_registers=2000), files={4: [0] * 10000, 5: [0] * 10000}
        ),
    }
    for unit in (11, 12, 17):
        devices[unit] = Device(
            Mapping(holding_registers={0: [unit, 0]}),
            identification={"VendorName": f"ACME {unit}"},
        )
    devices[12].server_id = pdu.ServerId(b"A", None, b"CME")
    for unit, cells in ((30, IRRADIANCE), (31, IRRADIANCE[:-2])):
        devices[unit] = Device(Mapping(holding_registers={40000: cells}))
    files = {"tank": TANK, "meter": METER, "meaning": MEANING, "bits": BITS}
    files["wrong"] = TANK.replace("coils,1", "relays,1").replace("uint16", "uint17")
    files["columns"], files["bad"] = COLUMNS, "name,addr\n" + "a,x\n" * 30
    points = (f"p{at},holding_registers,{at},uint16\n" for at in range(4))
    files["points"] = f"name,table,address,type\n{''.join(points)}"
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
    """Replace what is not the same in each run."""
    text = re.sub(r"127\.0\.0\.1:[0-9]+", "127.0.0.1:PORT", text)
    text = re.sub(r"20[0-9-]+T[0-9:.]+(Z|[+-][0-9:]+)", "TIME", text)
    text = re.sub(r" *\b[0-9.]+ (min|s|ms)\b(?! of)", " DURATION", text)
    return re.sub(r'"took": [0-9.]+', '"took": DURATION', text)


@pytest.mark.parametrize("name", SESSIONS)
def test_a_session_is_the_golden_file(name: str, url: str, tmp_path: Path, golden: Golden) -> None:
    lines = []
    for command in filter(None, map(str.strip, SESSIONS[name].splitlines())):
        lines.append(command if command.startswith("#") else f"$ libmodbus-py {command}")
        if command.startswith("#"):
            continue
        typed = {"URL": url, "HOST": url.partition("?")[0]}
        words = [word.replace("FOLDER", str(tmp_path)) for word in shlex.split(command)]
        # Readings go to the descriptor of the standard output: poll needs a process.
        call = ended if words[0] == "poll" else run
        done = call(*(typed.get(word, word) for word in words))
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
