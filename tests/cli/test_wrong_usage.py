"""
What is typed wrong, and what cannot be reached: one line on stderr names it. Nothing is printed,
made or written, and nothing is sent for wrong usage (exit code 2).

`h` is no host; FOLDER has a map, a wrong one, a fleet file, two files of the user and what is
no capture.
"""

import re
import shlex
from pathlib import Path

import pytest

from tests.cli.serving import FLEET_OF_ONE
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.names import resolve

FILES = {
    "meter.csv": "name,table,address,group\nlevel,holding,0,fast\n",
    "wrong.csv": "name,table,address\na,holding,70000\n",
    "fleet.toml": FLEET_OF_ONE.format(url="tcp://127.0.0.1:1"),
    "there.csv": "mine",
    "mine.py": "x = 1\n",
    "x.pcapng": "no capture",
}

GENERAL = [
    ("", "COMMAND"),
    ("--nonsense", "COMMAND"),
    ("reed 127.0.0.1", "there is no command 'reed'; did you mean read?"),
    ("help read", "there is no command 'help'; type libmodbus-py COMMAND --help"),
    ("version", "there is no command 'version'; type libmodbus-py --version"),
    ("map list.csv", "there is no command 'list.csv'; type libmodbus-py map check list.csv"),
    ("poll list.csv", "list.csv is a list: a fleet file in TOML names it as map = "),
    ("serve list.csv", "list.csv is no URL: type --map list.csv"),
    ("read 127.0.0.1 list.csv", "or with --map FILE a name; type --map list.csv"),
    ("read 127.0.0.1 hr 0 9 uint32", "type --type uint32, or the type behind the address"),
    ("watch h hr 0", "there is no command 'watch'; type libmodbus-py read ... --watch"),
    ("plc1 hr 0", "there is no command 'plc1'; a device of this name is read by"),
    ("--unit 1 read h hr 0", "options stand behind the command: libmodbus-py read --unit 1 ..."),
    ("--timeout 0.5 read 127.0.0.1 hr 0", "libmodbus-py read --timeout 0.5 ..."),
    ("completion tcsh", "must be one of bash, zsh, fish, not 'tcsh'"),
]

OPTIONS = [
    ("read h hr 0 --ordr CDAB", "; did you mean --order?"),
    ("read h hr 0 --format hex", "--format hex: type --hex, --json or --csv"),
    ("read h hr 0:float32 --swap", "--swap: type --order CDAB for the low word first"),
    ("scan h --registers", "--registers: type hr N COUNT to read them, or scan --deep"),
    ("serve h --log-level info", "--log-level info: type --log info"),
    ("listen /dev/x --for 2s", "--for 2s: type timeout 2s before libmodbus-py"),
    ("poll h:502 hr 0", "libmodbus-py read h:502 hr 0 --watch polls without a fleet file"),
    ("read h hr 0 --time 3", "unrecognized arguments: --time"),  # no beginnings of options
    ("map from-device h --time 1", "unrecognized arguments: --time"),
    ("map check x --devce h", "unrecognized arguments: --devce h; did you mean --device?"),
    ("serve h --unknown-unit refus", "not 'refus'; did you mean refuse?"),
    ("read h hr 0 --unit 256", "-u/--unit/--units: '256' must be within 0..255"),
    ("read h hr 0 -u x", "'x' must be a unit, or a range such as 1-247"),
    ("read h hr 0 -u 1,x", "'x' must be a unit, or a range such as 1-247"),
    ("read h hr 0 -u 9-1", "'9-1' must go up"),
    ("read h hr 0 --timeout 0", "timeout must be"),
    ("read h hr 0 --timeout 1y", "--timeout: must be a number of seconds, or such as 500ms"),
    ("read h hr 0 --retries 101", "retries must be in 0..100, not 101"),
    ("read h hr 0 --delimiter 300", "delimiter must be in 0..255"),
    ("read h hr 0 --keepalive x", "argument --keepalive: must be a number of seconds, or"),
    ("read /dev/x hr 0 -d 9", "data_bits must be in 5..8, not 9"),
    ("read /dev/x hr 0 -p mark", "argument -p/--parity: must be none, even or odd"),
    ("read /dev/x hr 0 --rs485 up", 'rs485 must be "kernel"'),
    ("read /dev/x hr 0 --max-in-flight 2", "max_in_flight must be 1 on"),
    ("read h hr 0 --echo", "--echo applies to serial ports only, not to tcp://h:502"),
    ("read h?unit=256 hr 0 --timeout 1", "unit must be in 0..255, not 256"),
    ("identify h --cert own.pem", "--cert applies to tls:// URLs only, not to tcp://h:502"),
]

URLS = [
    ("read modbus://127.0.0.1 hr 0", "scheme must be one of"),
    ("read 'a b:c:d' hr 0", "'a b:c:d'"),
    ("read user@host hr 0", "must be a URL"),
    ("read '' hr 0", "must be a URL"),
    ("read tls://h hr 0", "tls://h:802 needs security"),
    ("read tls://h hr 0 --ca x", "tls://h:802 lacks cert, the file"),
    ("read tls://h hr 0 --cert x", "tls://h:802 needs either ca"),
    ("read tls://h?cert=x hr 0", "tls://h:802 needs either ca, the authorities, or"),
    ("read tls://h?password=sesame hr 0", "'password' must be one of cert, key, ca"),
    ("read tls://me:sesame@h hr 0", "neither user nor fragment"),
]

ITEMS = [
    ("read h", "WHAT is missing"),
    ("read h colis 0", "colis"),
    ("read h holdng 0", "did you mean holding?"),
    ("read h hr 0 voltage", "'voltage' must be one of coils"),
    ("read h hr 0 1 2 3", "'2' must have 5 or 6 digits"),
    ("read h 0", "follow the name of a table, as in hr 122"),
    ("read h hr 0 1 coils", "coils lacks an address"),
    ("read h coils x", "address"),
    ("read h coils:1 0", "only a file"),
    ("read h file 0", "file:4"),
    ("read h file:0 0", "file must be in 1..65535"),
    ("read h file:4 0 0", "must be in 1..124, not 0"),
    ("read h 600007", "file:N"),
    ("read h 50001", "50001"),
    ("read h fifo 40 2", "fifo takes no count"),
    ("read h hr 65535 2", "must not pass 65536"),
    ("read h hr 65535:float32", "must not pass 65536"),
    ("read h hr 65530-65536", "address must be in 0..65535, not 65536"),
    ("read h hr 0 65537", "count must be in 1..65536"),
    ("read h 465535-465537", "the items are 400001..465536"),
    ("read h --count-from-1 co 65536 2", "must not pass 65536"),
    ("read h --count-from-1 hr 0", "address must be in 1..65536, not 0"),
    ("read h hr 5-3", "is no range of cells"),
    ("read h hr 0-2:float32", "is no range of registers of float32, 2 each"),
    ("read h 40001-30002", "both references must be of one table"),
    ("read h 40001=5", "'40001=5' has a value, which the command write takes"),
    (
        "read h holding 400101",
        "(holding 400101 counts from 0; the reference 400101 is typed without",
    ),
    ("read h hr 3.16", "bit must be in 0..15, not 16"),
    ("read h hr 3.1 2", "hr 3.1 is one bit, and takes no count"),
    ("read h coils 3.1", "coils 3.1: only holding and input registers have bits"),
    ("read h file:1 3.1", "only holding and input registers have bits"),
    ("read h hr 3.1-4", "address must be a number, not '3.1-4'"),
    ("read h hr 3 --bit 1", "type hr N.1, a bit of a register, of which 0 is the lowest"),
    ("read h coils 00012", "not '00012' (coils 00012 counts from 0; the reference 00012"),
    ("read h --map FOLDER/meter.csv levl", "no point 'levl'; did you mean level"),
    ("read h --map FOLDER/meter.csv level --type int16", "level has the type that the map gives"),
    ("read h hr 0 --map none", "'none' is neither the path of a register map, which ends with"),
    ("read h hr 0 --map plant", "the examples are abb_b23, "),
    ("read h hr 0 --map /dev/null/none", "/dev/null/none"),
    ("read h hr 0 --column name=x", "--column, --from and --list need --map"),
    ("read h --group x", "--group needs --map FILE"),
    ("read h hr 0 --group x", "--group needs --map FILE"),
    (
        "read h --map FOLDER/meter.csv --group x",
        "no points of a group 'x'; its groups are fast",
    ),
]

TYPES = [
    ("read h coils 0 --type int16", "only holding, input, file have"),
    ("read h 10001 --type int16", "discrete inputs have no type"),
    ("read h coils 0 --type all", "coils have no type"),
    ("read h hr 0 --type int9", "int16, int32, int64, int8,"),
    ("read h hr 0 --type ''", "date96, eui48, string:N, not ''"),
    ("read h hr 0 --type flaot32", "did you mean float32"),
    ("read h hr 0:flaot32", "did you mean float32"),
    ("read h hr 0 --type string", "did you mean string:N?"),
    ("read h hr 0:float32:XY", "order must be one of ABCD, CDAB, BADC, DCBA, not 'XY'"),
    ("read h hr 0:float:32:XY", "type must be one of"),
    ("read h hr 0:all", "type must be one of"),
    ("read h hr 0 --type string:251", "1..250, not 251"),
    ("read h file:1 0 --type string:250", "must be in 1..124, not 125"),
    ("read h hr 0 32769 --type int32", "count must be in 1..32768"),
    ("read h hr 0 0 --type int32", "count must be in 1..32768, not 0"),
    ("read h hr 0 --type int16 --order X", "ABCD, CDAB, BADC, DCBA"),
    ("read h hr 0 --type int32 --order AB", "order of int32"),
    ("read h hr 0 --order CDAB", "--order needs --type, or a type as in hr 100:float32"),
    ("read h hr 0 --encoding utf-8", "--encoding needs --type"),
    ("read h hr 0 --type string:4 --encoding klingon", "klingon"),
    ("read h hr 0 --type all --padding x", "has no --padding"),
]

OUTPUT = [
    ("read h hr 0 --type all --csv", "--type all cannot be used with --csv"),
    ("read h fifo 40 --csv", "fifo cannot be used with --csv"),
    ("read h hr 0 --csv --json", "not allowed with"),
    ("read h hr 0 --watch nan", "seconds"),
    ("read h hr 0 --watch 0", "0.01..86400"),
    ("read h hr 0 --watch 10x", "argument --watch: '10x' must be a number of seconds"),
    ("read h --watch hr 0", "must be the last argument"),
    ("read h hr 0 --count 0", "argument --count: must be a number of polls, 1 or more"),
    ("read h hr 0 --for soon", "--for: 'soon' must be a number of seconds, or such as 500ms"),
    ("read h hr 0 --watch 1 --page-token file", "--page-token needs --page"),
    ("read h hr 0 --watch 1 --page-url http://h", "--page-url needs --page"),
    ("read h hr 0 --watch 1 --page 127.0.0.1:0", "a new one is printed on a terminal only"),
]

WRITES = [
    ("write h coils 0", "no value"),
    ("write h hr 0 --type int16", "no value"),
    ("write h hr 0 1 hr 2", "no value to write to hr 2"),
    ("write h coils 0 2", "'2'"),
    ("write h hr 0 65536", "-32768..65535"),
    ("write h input 0 1", "can only be read"),
    ("write h input 3=4", "can only be read"),
    ("write h input 0 1 --type int16", "can only be read"),
    ("write h coils 0 1 --type int16", "coils have no type"),
    ("write h hr 0 1 --order CDAB", "--order needs --type"),
    ("write h hr 0 1 --type all", "string:N, not 'all'"),
    ("write h hr 0 1 65536 --type uint16", "values[1] must be in 0.."),
    ("write h hr 0 1.5 --type uint16", "a number, not '1.5'"),
    ("write h hr 0 x --type float32", "value must be a number, not 'x'"),
    ("write h hr 0 1e400 --type float32", "value is too large: '1e400'"),
    ("write h hr 0 1e39 --type float32", "values[0] must be in -3.4"),
    ("write h hr 0 12 --type bits16", "digits 0 and 1"),
    ("write h hr 0 101 --type bits16", "must hold 16 bits"),
    ("write h hr 0 abc --type string:2", "0..2 bytes in ascii"),
    (f"write h hr 0 {'1 ' * 62}--type int32", "must hold 1..123 values"),
    (f"write h file:1 0 {'1 ' * 31}--type int64", "must hold 1..122 values"),
    ("write h hr 3.1=2", "value must be one of 0, 1, off, on, false, true, not '2'"),
    ("write h hr 3.1 on off", "hr 3.1 is one bit: it takes one value"),
    ("write h hr 3.1 --mask 1 2", "--mask excludes values, and a bit such as hr 10.3"),
    ("write h ir 3.1=on", "can only be read"),
    ("write h hr 3=", "value must be a number, not ''"),
    ("write h hr 3-4 5", "the range from hr 3 on needs 2 values"),
    ("write h hr 3 1e3", "not '1e3'; type all digits, or a type as in hr 0:float32"),
    ("write h hr 3 1.5", "not '1.5'; type all digits, or a type as in hr 0:float32"),
    ("write h hr 0 1 --mask 1 2", "--mask excludes values, and a bit"),
    ("write h hr 0 --mask 1 2 --and-read 0 1", "not allowed with"),
    ("write h coils 0 --mask 1 2", "for holding registers"),
    ("write h hr 1 1 hr 2 3 --and-read 0 1", "one item"),
    ("write /dev/x -u 0 hr 0 1 --verify", "--verify cannot be used with unit 0: nothing answers"),
]

RAW = [
    ("raw h 3 xyz", "HEX must be pairs of hex digits, not 'xyz'"),
    *((f"raw h 3 {words}", "HEX must be pairs of hex digits, not '") for words in (
        "0 0 0 2", "000 0002", "0000 000 2", "0000 2", "00 0 0 02", "0x0000000", "0",
    )),
    ("raw h 200", "function must be in 1..127"),
    ("raw h three", "function must be a number"),
    ("raw h 10 00 01", "FUNCTION 10 can be 0x10 or 0x0a"),
    ("raw h 16 00 01", "FUNCTION 16 can be 0x16 or 0x10"),
    ("raw h 43 00 01", "FUNCTION 43 can be 0x43 or 0x2b"),
]  # fmt: skip

MAPS = [
    ("map chek x", "there is no command 'chek'; did you mean check?"),
    ("map check sdm", "'sdm' is neither the path of a register map"),
    ("map class sdm", "'sdm' is neither the path of a register map"),
    ("map check meter --column name", "must be KEY=HEADING"),
    ("map check meter --column name=x", "no column x, which is named for name"),
    ("map check meter --column nam=x", "columns must name some of name"),
    ("map check sdm120 --unit 17", "--unit needs --device"),
    ("map check sdm120 --baudrate 9600", "--baudrate needs --device"),
    ("map check sdm120 --ca a.pem", "--ca needs --device"),
    ("map class sdm120 -o FOLDER/mine.py", "mine.py exists, and would be overwritten"),
    ("map class sdm120 -o FOLDER/meter.txt", "meter.txt: it must end with .py"),
    ("map class sdm120 -o FOLDER/none/meter.py", "none/meter.py: the folder does not exist"),
    ("map from-device h -o found.xlsx", "found.xlsx: it must end with .toml or .csv"),
    ("map from-device h -o FOLDER/there.csv", "there.csv exists, and would be overwritten"),
    ("map from-device h -o FOLDER/no/found.csv", "/no/found.csv: the folder does not exist"),
    ("map from-device h -o FOLDER/found.csv -u 300", "unit must be in 0..255, not 300"),
]

FINDING = [
    ("scan h --units=0-300", "'0-300' must go up, within 0..255"),
    ("scan h --units=9-5", "'9-5' must go up, within 0..255"),
    ("scan h --units=1,,3", "'' must be a unit, or a range such as 1-247"),
    ("scan h --units=-3", "'-3' must be a unit"),
    ("scan h --units=٣", "must be a unit"),
    ("scan h --baudrates=96OO", "'96OO' must be a number"),
    ("scan h --baudrates=9600,,", "'' must be a number"),
    ("scan h --baudrates=9600", "baudrates are for serial ports"),
    ("scan h -b 9600 --json FOLDER/found.json", "baudrates are for serial ports"),
    ("scan h --parities=E,X", "'X' must be none, even or odd"),
    ("scan h --timeout=0", "timeout must be in 0.001..86400 seconds"),
    ("scan 10.0.0.0/15", "'10.0.0.0/15' has 131072 hosts, and a scan tries 65536 at most"),
    ("scan 192.0.2.0/33", "'192.0.2.0/33': "),
    ("scan 192.0.2.0/30:99999", "the port must be in 1..65535"),
    ("scan 10.0.0.0/16", "65534 hosts are more than 1024: --yes tries them without a question"),
    ("listen tcp://127.0.0.1:1502", "the scheme must be rtu, ascii"),
    ("listen rtu+tcp://127.0.0.1:0", "between is missing"),
    ("listen rtu:///dev/null --between rtu+tcp://127.0.0.1:1", "only read"),
    ("listen rtu+tcp://h:0 --between ttyUSB0", "rtu:///dev/ttyUSB0: the scheme must be"),
    ("listen x.txt", "the scheme must be rtu, ascii"),
    ("read h hr 0:float32 --max-registers 1", "float32 takes 2 registers, which is more than"),
    ("listen FOLDER/x.pcapng", "x.pcapng: byte 4: no pcapng or pcap file"),
    ("listen x.pcapng -b 9600", "--baudrate applies to serial ports only, not to x.pcapng"),
]

SERVERS = [
    ("serve", "the following arguments are required: URL"),
    ("serve tcp://127.0.0.1:99999", "port"),
    ("serve tcp://127.0.0.1:0?unit=7", "unit is for clients"),
    ("serve 127.0.0.1:0 --own-unit 1", "own_unit cannot be given"),
    ("serve 127.0.0.1:0 --own-unit one", "--own-unit"),
    ("serve tcp://h -b 9600", "--baudrate applies to serial ports only, not to tcp://h:502"),
    ("serve tcp://h --max-connections 0", "max_connections must be"),
    ("serve tcp://h --frame-timeout 0", "frame_timeout must be"),
    ("serve 127.0.0.1:0 --device /no/x.toml", "cannot read /no/x.toml: No such file"),
    ("serve h --device x -u 3", "--units cannot be given with x"),
    ("serve 127.0.0.1:0 --page x", "--page: must be HOST:PORT, such as 127.0.0.1:8080"),
    ("serve 127.0.0.1:0 --page-token file", "--page-token needs --page"),
    ("serve 127.0.0.1:0 --page 127.0.0.1:0", "a new one is printed on a terminal only"),
    ("serve 127.0.0.1:0 --column name=x", "--column, --from and --list need --map"),
    (
        "serve 127.0.0.1:0 --map nosuch",
        "'nosuch' is neither the path of a register map, which ends",
    ),
    ("serve 127.0.0.1:0 --map FOLDER/wrong.csv", "wrong.csv, line 2, column address: address must"),
    ("serve 127.0.0.1:0 plant.toml", "plant.toml is no URL: type --device plant.toml"),
    ("serve 127.0.0.1:0 --map sdm120 --reload", "--reload needs --device or --example"),
    ("serve 127.0.0.1:0 --map sdm120 --device x", "--device: not allowed with argument --map"),
    ("serve 127.0.0.1:0 --map sdm120 -u 249", "units must be in 0..247, or 255, not 249"),
    ("serve 127.0.0.1:0 --state FOLDER/none/state", "none/state: No such file or directory"),
    ("serve 127.0.0.1:0 --audit-required", "--audit-required needs --audit"),
    ("serve 127.0.0.1:0 --audit /", "--audit: /: Is a directory"),
    ("serve 127.0.0.1:0 --audit /no/file", "No such file or directory"),
    ("gateway 127.0.0.1:0", "either --to or --config must say"),
    ("gateway plant.toml", "must say where the devices are: type --config plant.toml"),
    ("gateway h --to 1=tcp://b --to 1=tcp://c", "an earlier route has unit 1 already"),
    ("gateway h --to 1-x=192.0.2.1", "'1-x' must be a unit"),
    ("gateway 127.0.0.1:5020 --to 127.0.0.1:5020", "the gateway itself listens"),
    ("gateway 127.0.0.1:0 --to /dev/nowhere", "there is no serial port /dev/nowhere"),
    ("gateway --to tcp://192.0.2.1", "urls must name at least one endpoint"),
    ("gateway 127.0.0.1:0 --to tcp://b --queue 0", "queue must be in 1..1024, not 0"),
    ("gateway tcp://h --to tcp://b -s 1", "--stop-bits applies to serial ports only"),
    ("gateway --config /nowhere/gateway.toml", "cannot read /nowhere/gateway.toml"),
    ("gateway --config x -u 3", "x: No such file"),
    ("gateway 127.0.0.1:0 --to h --page-token file", "--page-token needs --page"),
    ("gateway 127.0.0.1:0 --to h --page 127.0.0.1:0", "a new one is printed on a terminal only"),
    ("gateway 127.0.0.1:0 --to h --audit-required", "--audit-required needs --audit"),
    ("poll /nowhere/fleet.toml", "cannot read /nowhere/fleet.toml: No such file or directory"),
    ("poll FOLDER/fleet.toml --once --check", "not allowed with argument --once"),
    ("poll FOLDER/fleet.toml --json --csv", "two outputs use the standard output"),
    ("poll FOLDER/fleet.toml --csv --csv", "two outputs use the standard output"),
    ("poll FOLDER/fleet.toml --csv /tmp/a --json /tmp/../tmp/a", "two outputs use the file /tmp/a"),
    ("poll FOLDER/fleet.toml --metrics x", "must be HOST:PORT"),
]

CERTIFICATES = [
    ("certificates FOLDER/new --days 0", "days must be in 1..36500"),
    ("certificates FOLDER/new --days 99999999999999999999", "days must be in 1..36500"),
    ("certificates FOLDER/new --role ''", "no file name"),
    ("certificates FOLDER/new --role CA", "no file name"),
    ("certificates FOLDER/new --role 'a b' --role a-b", "no file name"),
    ("certificates FOLDER/new --role 'a\nb'", "control characters"),
    (f"certificates FOLDER/new --role {'a' * 256}", "1..255 bytes"),
    ("certificates FOLDER/new --host plc\u00e4", "host"),
    ("certificates FOLDER/new --host ''", "host"),
    ("certificates FOLDER/new ../n1", "MACHINE '../n1' is neither an address nor a name"),
    ("certificates FOLDER/new ..", "neither an address nor a name"),
    ("certificates FOLDER/new n1 --role Operator", "--host and --role are for trials"),
    ("certificates FOLDER/new n1 --days 0", "days must be in 1..36500"),
    ("certificates FOLDER/new n\u00e4", "neither an address nor an ASCII name"),
]

WRONG = [
    *(GENERAL + OPTIONS + URLS + ITEMS + TYPES + OUTPUT + WRITES + RAW),
    *(MAPS + FINDING + SERVERS + CERTIFICATES),
]

DECODED = Path(__file__).parents[1] / "tools" / "listener" / "decoded.pcapng"

UNREACHABLE = [
    ("read 127.0.0.1:1 hr 0", "cannot connect to 127.0.0.1:1"),
    ("read plc.example:1 hr 0", "cannot connect to plc.example:1"),
    ("read no-such-host.invalid hr 0", "no-such-host"),
    ("read [::1]:1 hr 0", "cannot connect to [::1]:1"),
    ("read 127.0.0.1:1?unit=9 hr 0", "unit 9: cannot connect"),
    ("read 127.0.0.1:1?unit=9 hr 0 -u 8", "unit 8: cannot connect"),
    ("read /dev/no-such hr 0 -b 9600 -p none -s 2", "cannot open /dev/no-such"),
    ("read ./no-such hr 0", "no-such: No such file"),
    ("read 127.0.0.1:1 hr 0 --json /nowhere/x", ": /nowhere/x: No such file or directory"),
    ("read 127.0.0.1:1 hr 0 --json=/nowhere/x", ": /nowhere/x: No such file or directory"),
    ("ttyUSB99 hr 0", "/dev/ttyUSB99"),
    ("read ttyUSB99?baudrate=9600 hr 0", "/dev/ttyUSB99"),
    ("identify ttyACM99", "/dev/ttyACM99"),
    ("identify 127.0.0.1:1 -u 1-9", "cannot connect to 127.0.0.1:1"),
    ("diagnose 127.0.0.1:1 -u 1-9", "cannot connect to 127.0.0.1:1"),
    ("map from-device 127.0.0.1:1 -o FOLDER/found.csv", "cannot connect to 127.0.0.1:1"),
    ("serve ttyS99", "/dev/ttyS99"),
    ("serve rtu:///dev/null", "not a serial port"),
    ("gateway ttyUSB99 --to 127.0.0.1:1", "/dev/ttyUSB99"),
    ("listen ttyUSB99", "cannot open /dev/ttyUSB99: No such file or directory"),
    ("listen nowhere.pcapng", "nowhere.pcapng: No such file or directory"),
    (f"listen {DECODED} --capture /dev/full", "/dev/full: No space left on device"),
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    resolve(monkeypatch, "plc.example")
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    return tmp_path


@each_case(
    ("code", "line", "said"), [*((2, *row) for row in WRONG), *((1, *row) for row in UNREACHABLE)]
)
def test_one_line_names_what_is_wrong(folder: Path, code: int, line: str, said: str) -> None:
    done = run(*shlex.split(line.replace("FOLDER", str(folder))))
    assert (done.code, done.out) == (code, ""), done.err
    assert done.err.startswith("libmodbus-py: ")
    assert done.err.count("\n") == 1
    assert said in done.err
    assert not re.search("sesame|token=", done.err)
    assert {each.name: each.read_text() for each in folder.iterdir()} == FILES
