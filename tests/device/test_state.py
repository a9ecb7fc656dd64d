"""Values of devices in files: saved, loaded again, and refused with the key that is wrong."""

import errno
import json
import os
import resource
import signal
import stat
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Device, Mapping, Point, RegisterMap
from tests.device.devices import contents
from tests.support.cases import each_case


def plant() -> Device:
    mapping = Mapping(
        coils=range(3, 20),
        discrete_inputs=4,
        holding_registers=[range(10), range(1000, 1600)],
        input_registers={7: [1, 2]},
    )
    return Device(mapping, files={4: {3: 1, 4: 2, 9: 3}, 65535: [0] * 10_000})


def test_saved_values_are_loaded(tmp_path: Path) -> None:
    path = tmp_path / "values"
    saved = plant()
    saved.mapping.coils[5] = True
    saved.mapping.discrete_inputs[3] = True
    saved.mapping.holding_registers[9] = 65535
    saved.mapping.holding_registers[1000:1600] = range(600)
    saved.mapping.input_registers[8] = 0
    saved.files[4][3] = 0
    saved.files[65535][9999] = 65535
    saved.save(path)
    loaded = plant()
    loaded.mapping.holding_registers[3] = 4  # which the file does not have
    loaded.load(path)
    assert contents(loaded) == contents(saved)
    saved.load(path)
    assert contents(loaded) == contents(saved)
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    assert os.listdir(tmp_path) == ["values"]


def test_the_text_of_a_file(tmp_path: Path) -> None:
    points = RegisterMap(
        [
            Point("setpoint", "holding_registers", 107, type="int32"),
            Point("limit", "holding_registers", 109),
        ]
    )
    mapping = Mapping(coils=4, holding_registers=range(100, 110))
    device = Device(mapping, files={4: [0, 0, 1711]}, points=points)
    mapping.coils[1:3] = [True, True]
    mapping.holding_registers[107:109] = [1, 65535]
    device.save(tmp_path / "values")
    assert (tmp_path / "values").read_text() == (
        '{"libmodbus-py": "state", "version": 1, "units": {\n'
        '"every": {"points": {"setpoint": ["holding_registers", 107, 1, "int32", "ABCD"]},'
        ' "coils": {"1": [1, 1]}, "holding_registers": {"107": [1, 65535]},'
        ' "files": {"4": {"2": [1711]}}}\n'
        "}}\n"
    )


@given(st.dictionaries(st.integers(0, 599), st.integers(0, 65535)))
def test_any_saved_values_are_loaded_unchanged(values: dict[int, int]) -> None:
    saved, loaded = (Device(Mapping(holding_registers=600), files={1: [0] * 600}) for _ in "12")
    for address, value in values.items():
        saved.mapping.holding_registers[address] = value
        saved.files[1][599 - address] = value
    path = Path(tempfile.gettempdir()) / f"libmodbus-py-{os.getpid()}"
    try:
        saved.save(path)
        loaded.load(path)
    finally:
        path.unlink(missing_ok=True)
    assert contents(loaded) == contents(saved)


def test_loading_calls_no_hook(tmp_path: Path) -> None:
    device = Device(Mapping(coils=1), before_write=pytest.fail, after_write=pytest.fail)
    device.mapping.coils[0] = True
    device.save(tmp_path / "values")
    device.mapping.coils[0] = False
    device.load(tmp_path / "values")
    assert device.mapping.coils[0] is True


def text_of(units: Any, **head: Any) -> str:
    return json.dumps({"libmodbus-py": "state", "version": 1, "units": units} | head)


UNIT = {"holding_registers": {"0": [1]}}

DAMAGED = [
    ("", "line 1, column 1: not JSON"),
    ("\n", "line 2, column 1: not JSON"),
    ("meter = 1\n", "line 1, column 1: not JSON"),
    ("{}", 'libmodbus-py must be "state": this is not a file of values'),
    ("[]", r"must be an object, not \[\]"),
    ('{"unit": 3}', 'libmodbus-py must be "state"'),
    (text_of({"every": UNIT})[:-1], "line 1, column [0-9]+: not JSON: .* cut off"),
    (text_of({"every": UNIT}) + "x", "line 1, column [0-9]+: not JSON: Extra data"),
    ("{" * 100_000, "not JSON: "),
    ("[" * 100_000, "not JSON: too deep"),
    (text_of({}, version=2), "version must be 1, not 2: the file was written by a newer"),
    (text_of({}, version=0), "version must be in 1.."),
    (text_of({}, version=None), "version must be"),
    (text_of({}, version=True), "version must be"),
    (text_of({}, version="1"), "version must be"),
    (text_of({}, more=1), "more: no such key; allowed are libmodbus-py, version, units"),
    (text_of(3), "units must be an object, not 3"),
    ('{"libmodbus-py": "state", "version": 1}', "units must be an object, not None"),
    ('{"libmodbus-py": "state", "version": 1, "version": 1}', "version: occurs twice"),
    (text_of({"1": UNIT}), "units.1: no such unit is served, only every"),
    (text_of({"a\nb": UNIT}), r"units.a\\nb: no such unit is served"),
    (text_of({"\ud800": UNIT}), r"units.\\ud800: no such unit is served"),
    (text_of({})[:-1] + "9" * 5000 + "}", "line 1, column [0-9]+: "),
    (text_of({}).replace("1", "9" * 5000), "Exceeds the limit"),
    (text_of({"every": [1]}), r"units.every must be an object, not \[1\]"),
    (text_of({"every": {"0": [1]}}), "units.every.0: no such key; allowed are points, coils, "),
    (
        text_of({"every": {"points": {"a": ["coils", 3, 1, None, "ABCD"]}}}),
        "units.every.points.a: the device has no such point",
    ),
]


@each_case(("text", "message"), DAMAGED)
def test_damaged_files_are_refused(text: str, message: str, tmp_path: Path) -> None:
    refused(tmp_path, text, message)


H = "holding_registers"

RUNS: list[tuple[dict[str, Any], str]] = [
    ({"holding": {"0": [1]}}, "holding: no such key"),
    ({H: [1]}, r"holding_registers must be an object, not \[1\]"),
    ({H: {"-1": [1]}}, "holding_registers.-1 must be a number in 0..65535"),
    ({H: {"1.0": [1]}}, "holding_registers.1.0 must be a number"),
    ({H: {"": [1]}}, "holding_registers. must be a number"),
    ({H: {"٣": [1]}}, "must be a number"),
    ({H: {"65536": [1]}}, "holding_registers.65536 must be in 0..65535, not 65536"),
    ({H: {"9": [1, 2]}}, "holding_registers.9: the device lacks holding_registers 9..10"),
    ({H: {"999": [1]}}, "holding_registers.999: the device lacks holding_registers 999..999"),
    ({H: {"65535": [1, 2]}}, "the device lacks holding_registers 65535..65536"),
    ({H: {"0": []}}, "holding_registers.0 must be a list that is not empty"),
    ({H: {"0": 3}}, "holding_registers.0 must be a list"),
    ({H: {"0": [1, 65536]}}, r"holding_registers.0\[1\] must be in 0\.\.65535, not 65536"),
    ({H: {"0": [True]}}, r"holding_registers.0\[0\] must be"),
    ({H: {"0": [1.5]}}, r"holding_registers.0\[0\] must be"),
    ({H: {"0": [float("nan")]}}, r"holding_registers.0\[0\] must be"),
    ({H: {"0": [None]}}, r"holding_registers.0\[0\] must be"),
    ({H: {"0": [1, 2, 3], "2": [1]}}, "holding_registers: 2 has two values"),
    ({H: {"7": [1], "07": [1]}}, "holding_registers: 7 has two values"),
    ({"coils": {"3": [2]}}, r"coils.3\[0\] must be in 0\.\.1"),
    ({"files": {"5": {"0": [1]}}}, "files.5.0: the device lacks file 5 0..0"),
    ({"files": {"4": {"4": [1, 2]}}}, "files.4.4: the device lacks file 4 4..5"),
    ({"files": {"4": [1]}}, "files.4 must be an object"),
    ({"files": {"0": {"0": [1]}}}, "files.0.0: the device lacks file 0..0"),
    ({"files": {"x": {"0": [1]}}}, "files.x must be a number"),
]


@each_case(("unit", "message"), RUNS)
def test_wrong_values_are_refused(unit: dict[str, Any], message: str, tmp_path: Path) -> None:
    """No value is set, although valid values come before the wrong one."""
    good = {"input_registers": {"7": [9]}}
    refused(tmp_path, text_of({"every": good | unit}), f"(units.every.)?{message}")


def refused(folder: Path, text: str, message: str) -> None:
    path = folder / "values"
    path.write_text(text)
    device = plant()
    device.mapping.holding_registers[3] = 4
    before = contents(device)
    with pytest.raises(ValueError, match=message) as caught:
        device.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert contents(device) == before


def test_a_file_in_another_layout_is_read(tmp_path: Path) -> None:
    path = tmp_path / "values"
    path.write_text(json.dumps(json.loads(text_of({"every": UNIT})), indent=4))
    device = plant()
    device.load(path)
    assert device.mapping.holding_registers[0] == 1
    assert device.mapping.input_registers[7] == 0


def test_every_cut_and_every_changed_byte_is_refused(tmp_path: Path) -> None:
    saved = plant()
    saved.mapping.holding_registers[1000:1003] = [500, 0, 7]
    saved.mapping.coils[4] = True
    path = tmp_path / "values"
    saved.save(path)
    data = path.read_bytes()
    device = plant()
    before = contents(device)
    for length in range(len(data) - 1):  # without the last line feed it is whole
        path.write_bytes(data[:length])
        with pytest.raises(ValueError, match="not JSON"):
            device.load(path)
        assert contents(device) == before
    for at in range(len(data)):
        path.write_bytes(data[:at] + b"\xff" + data[at + 1 :])
        with pytest.raises(ValueError, match=rf"values: not UTF-8 at byte {at}$"):
            device.load(path)


def test_paths_that_are_no_file_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        with pytest.raises(OSError, match=f"(not a regular file|Is a directory): '{path}'"):
            plant().load(path)
    with pytest.raises(FileNotFoundError):
        plant().load(tmp_path / "missing")
    with pytest.raises(FileNotFoundError, match=r"missing/values'$"):
        plant().save(tmp_path / "missing" / "values")


def test_symbolic_links_and_permissions_are_kept(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    target, link = tmp_path / "other" / "values", tmp_path / "link"
    link.symlink_to(target)
    plant().save(link)
    target.chmod(0o640)
    plant().save(link)
    assert link.is_symlink()
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert os.listdir(tmp_path / "other") == ["values"]


@each_case("step", ["fsync", "replace", "fchmod"])
def test_a_failed_save_leaves_the_file(step, tmp_path, monkeypatch) -> None:
    path = tmp_path / step
    device = plant()
    device.save(path)
    before = path.read_bytes()

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    device.mapping.coils[4] = True
    with monkeypatch.context() as patched:
        patched.setattr(os, step, fail)
        with pytest.raises(OSError, match="No space left"):
            device.save(path)
    assert path.read_bytes() == before
    assert not list(tmp_path.glob("*.new"))
    device.save(path)
    assert path.read_bytes() != before


@each_case("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to(path)])
def test_what_is_no_regular_file_is_not_replaced(make, tmp_path) -> None:
    path = tmp_path / getattr(make, "__name__", "link").strip("<>")
    make(path)
    before = os.lstat(path)
    with pytest.raises(OSError, match=r"regular|directory|symbolic"):
        plant().save(path)
    after = os.lstat(path)
    assert (after.st_ino, after.st_mode) == (before.st_ino, before.st_mode)
    assert not list(tmp_path.glob("*.new"))


def test_a_disk_that_is_full_in_the_middle_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "values"
    device = plant()
    device.save(path)
    before = path.read_bytes()
    device.mapping.holding_registers[1000:1600] = range(600)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            device.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["values"]


KILLED = """
import os, signal, sys
from libmodbus_py import Device, Mapping
from libmodbus_py.device import state

device = Device(Mapping(holding_registers=600))
path, at = sys.argv[1], 0
device.save(path)
device.mapping.holding_registers[:] = range(600)
while True:
    at += 1
    child = os.fork()
    if not child:
        steps = 0

        def trace(frame, event, _):
            global steps
            if frame.f_code is state.replace_file.__code__:
                steps += 1
                if steps == at:
                    os.kill(os.getpid(), signal.SIGKILL)
                return trace

        sys.settrace(trace)
        device.save(path)
        os._exit(0)
    ended = os.waitpid(child, 0)[1]
    loaded = Device(Mapping(holding_registers=600))
    loaded.load(path)
    assert list(loaded.mapping.holding_registers) in ([0] * 600, list(range(600))), at
    state.remove_leftovers(path)
    assert os.listdir(os.path.dirname(path)) == ["values"], at
    if ended == 0:
        break
print(at)
"""


def test_a_program_that_is_killed_at_any_step_of_saving_leaves_a_whole_file(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, tmp_path / "values"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=50)
    assert process.stderr == ""
    assert int(process.stdout) > 10


def test_concurrent_saves_of_one_file_leave_one_complete_file(tmp_path: Path) -> None:
    path, devices = tmp_path / "values", [plant() for _ in range(4)]
    for number, device in enumerate(devices):
        device.mapping.holding_registers[1000:1600] = [number + 1] * 600

    def save(device: Device) -> None:
        for _ in range(10):
            device.save(path)

    with ThreadPoolExecutor(len(devices)) as pool:
        for _ in pool.map(save, devices):
            plant().load(path)
    loaded = plant()
    loaded.load(path)
    assert contents(loaded) in list(map(contents, devices))
    assert os.listdir(tmp_path) == ["values"]
