"""The package as a whole: what an import brings, what is public, all of libmodbus."""

import ast
import copy
import ctypes
import errno
import importlib
import importlib.util
import inspect
import os
import pickle
import pydoc
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path
from typing import Any

import pytest

import libmodbus_py
from libmodbus_py import Client, Device, Mapping, low_level, pdu
from libmodbus_py.low_level import ffi, lib, loaded_version
from libmodbus_py.ports.schemes import TRANSPORTS
from libmodbus_py.protocol import errors
from libmodbus_py.protocol.errors import (
    ExceptionResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
)

PACKAGE = Path(libmodbus_py.__file__).parent
# Names such as "context" and "pdu.reads"; a package has that of its __init__, such as "pdu".
MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if path.stem.isidentifier()  # PyInstaller gives its hooks names that nothing can import
}

# Python 3.11 has no modbus-connection, which one folder is about.
LACKING = [
    path
    for name in ("modbus_connection",)
    for path in (name, f"services.integrations.{name}")
    if importlib.util.find_spec(name) is None
]
IMPORTABLE = [
    name
    for name in MODULES
    if name not in ("__init__", "__main__") and not name.startswith(tuple(LACKING))
]


def test_public_modules_do_not_hand_out_private_names() -> None:
    for name in IMPORTABLE:
        exported = getattr(importlib.import_module(f"libmodbus_py.{name}"), "__all__", [])
        assert [text for text in exported if text.startswith("_")] == []


FOLDERS = sorted({name.split(".")[0] for name in MODULES if "." in name})


# The modules beside the folders, except those that programs do not import.
PUBLIC_MODULES = sorted(
    name
    for name, path in MODULES.items()
    if path.parent == PACKAGE and name not in ("__init__", "__main__", "late", "system", "version")
)


class TestMap:
    """Users start at ``help(libmodbus_py)``, contributors at the docstrings of the folders."""

    def test_help_begins_with_an_example_and_the_names_that_matter(self) -> None:
        head = pydoc.plaintext.document(libmodbus_py).splitlines()[:35]
        rulers = [number for number, line in enumerate(head) if line.strip().startswith("====")]
        assert 'with Client("tcp://192.0.2.10"' in "\n".join(head[: rulers[0]])
        names = [line.split()[0] for line in head[rulers[0] + 1 : rulers[1]]]
        assert len(names) == 9
        assert set(names) <= set(libmodbus_py.__all__)

    def test_the_example_of_help_compiles(self) -> None:
        text = (libmodbus_py.__doc__ or "").partition("::\n")[2].partition("\nAddresses")[0]
        assert ast.parse(textwrap.dedent(text)).body

    def test_help_names_every_public_module(self) -> None:
        text = (libmodbus_py.__doc__ or "").partition("Modules with more public names")[2]
        assert [item for item in PUBLIC_MODULES if not re.search(rf"\b{item}\b", text)] == []

    def test_contributing_md_names_every_folder(self) -> None:
        text = (PACKAGE.parent / "CONTRIBUTING.md").read_text()
        assert [folder for folder in FOLDERS if f"`{folder}`" not in text] == []

    @pytest.mark.parametrize("folder", FOLDERS)
    def test_each_folder_names_its_files(self, folder: str) -> None:
        text = importlib.import_module(f"libmodbus_py.{folder}").__doc__ or ""
        files = {name.split(".")[1] for name in MODULES if name.startswith(f"{folder}.")}
        if folder == "server":  # a table names the files of transports
            files -= {*TRANSPORTS}
        assert sorted(file for file in files if not re.search(rf"\b{file}\b", text)) == []


SHORT_PATHS = {
    **{name: f"protocol.{name}" for name in ("errors", "framing", "pdu", "values")},
    "device_file": "tools.simulator.device_file",
}


class TestPublicNames:
    def test_every_public_name_exists(self) -> None:
        assert sorted(set(libmodbus_py.__all__)) == sorted(libmodbus_py.__all__)
        missing = [name for name in libmodbus_py.__all__ if not hasattr(libmodbus_py, name)]
        assert missing == []

    def test_the_package_itself_has_few_names(self) -> None:
        stub = (PACKAGE / "__init__.pyi").read_text()
        names = re.findall(r"^from .* import .* as (\w+)$", stub, re.MULTILINE)
        assert len(names) <= 46
        assert {*libmodbus_py.__all__} < {*names}

    @pytest.mark.parametrize("package", [libmodbus_py, pdu])
    def test_every_public_name_is_imported_in_every_way(self, package: Any) -> None:
        names: dict[str, object] = {}
        exec(f"from {package.__name__} import *", names)
        assert set(package.__all__) <= set(names)
        assert set(package.__all__) <= set(dir(package))
        with pytest.raises(AttributeError, match="has no attribute 'TcpContex'"):
            _ = package.TcpContex
        with pytest.raises(ImportError, match="cannot import name 'TcpContex'"):
            exec(f"from {package.__name__} import TcpContex")

    @pytest.mark.parametrize("name", SHORT_PATHS)
    def test_short_paths_lead_to_the_modules_themselves(self, name: str) -> None:
        home = importlib.import_module(f"libmodbus_py.{SHORT_PATHS[name]}")
        assert importlib.import_module(f"libmodbus_py.{name}") is home

    def test_every_public_name_of_every_module_exists(self) -> None:
        for name in IMPORTABLE:
            module = importlib.import_module(f"libmodbus_py.{name}")
            missing = [item for item in getattr(module, "__all__", []) if not hasattr(module, item)]
            assert missing == [], name

    def test_the_package_is_distributed_whole(self) -> None:
        """A directory that pyproject.toml forgets would be missing from the wheel."""
        text = (PACKAGE.parent / "pyproject.toml").read_text()
        assert tomllib.loads(text)["tool"]["setuptools"]["packages"]["find"] == {
            "include": ["libmodbus_py*"]
        }
        for path in MODULES.values():
            assert (path.parent / "__init__.py").exists()
        patterns = tomllib.loads(text)["tool"]["setuptools"]["package-data"]["libmodbus_py"]
        data = {path for pattern in patterns for path in PACKAGE.glob(pattern)}
        ignored = {".c", ".h", ".o", ".py", ".pyc", ".so"}
        # What Python is writing at this moment has other suffixes.
        paths = (path for path in PACKAGE.rglob("*.*") if path.parent.name != "__pycache__")
        others = {path for path in paths if path.is_file()}
        assert {path for path in others if path.suffix not in ignored} == data

    def test_every_error_is_public(self) -> None:
        classes = {
            name
            for name, value in vars(errors).items()
            if inspect.isclass(value) and issubclass(value, Exception)
        }
        assert classes == set(errors.__all__)

    def test_every_public_class_and_function_has_a_docstring(self) -> None:
        for name in libmodbus_py.__all__:
            value = getattr(libmodbus_py, name)
            assert inspect.getdoc(value), name
            if inspect.isclass(value):
                for attribute, member in vars(value).items():
                    if not attribute.startswith("_") and inspect.isfunction(member):
                        assert inspect.getdoc(getattr(value, attribute)), f"{name}.{attribute}"

    def test_no_cdata_is_public(self) -> None:
        mapping = Mapping(4, 4, 4, 4)
        device = Device(mapping, files={1: [0]})
        holders = [libmodbus_py, mapping, mapping.coils, mapping.input_registers, device]
        public = [getattr(libmodbus_py, name) for name in libmodbus_py.__all__]
        for holder in [*holders, device.files[1], *public]:
            for name in dir(holder):
                if name.startswith("_"):
                    continue
                if inspect.ismodule(holder):
                    value = getattr(holder, name)  # which may import the name now
                else:
                    value = inspect.getattr_static(holder, name)
                if isinstance(value, property) and not inspect.isclass(holder):
                    value = getattr(holder, name)
                assert not isinstance(value, ffi.CData), f"{holder!r}.{name}"

    def test_version_is_that_of_the_distribution(self) -> None:
        from importlib.metadata import version

        assert libmodbus_py.__version__ == version("libmodbus-py")

    def test_every_request_is_a_method_of_the_same_name(self) -> None:
        """ReadCoils is what Client.read_coils sends, with the same parameters."""
        requests = {*pdu.REQUESTS.values(), pdu.ReadDeviceIdentification}
        for request in requests:
            name = re.sub(r"(?<!^)(?=[A-Z])", "_", request.__name__).lower()
            method = getattr(Client, name, None)
            assert callable(method), f"{request.__name__}: no {name}"
            if request in (pdu.ReadDeviceIdentification, pdu.Diagnostics):
                continue  # several requests, and a number instead of its bytes
            parameters = list(inspect.signature(method).parameters)[1:]
            assert parameters == list(inspect.signature(request).parameters), name

    def test_every_request_method_has_a_request(self) -> None:
        names = {
            "".join(word.capitalize() for word in name.split("_"))
            for name, value in inspect.getmembers(Client)
            if inspect.isfunction(value) and re.match(r"(read|write|mask|report)_", name)
        }
        lacking = (
            names
            - {"ReadMany", "ReadMap", "ReadValue", "ReadValues"}
            - {"WriteMap", "WriteValue", "WriteValues"}
            - set(pdu.__all__)
        )
        assert not lacking
        assert {"diagnostics", "encapsulated_transport", "execute"} < set(dir(Client))

    def test_signatures_are_not_changed_for_other_programs(self) -> None:
        signatures = {
            "read_exception_status": "()",
            "diagnostics": "(sub_function, data=0)",
            "read_comm_event_counter": "()",
            "read_comm_event_log": "()",
            "report_server_id": "()",
            "read_fifo_queue": "(address)",
            "read_device_identification": "(level='basic')",
            "encapsulated_transport": "(mei_type, data)",
            "execute": "(request, *, timeout=None, retries=None)",
        }
        for name, text in signatures.items():
            signature = inspect.signature(getattr(Client, name))
            bare = [
                parameter.replace(annotation=inspect.Parameter.empty)
                for parameter in list(signature.parameters.values())[1:]
            ]
            assert str(inspect.Signature(bare)) == text, name


SLOW = {"asyncio", "ssl", "logging", "random", "argparse", "subprocess", "hashlib"}
"""Modules of Python that take longer than what they would be imported for."""


def imported_by(program: str) -> set[str]:
    """Without site, which imports what editable installations need."""
    code = (
        f"import sys; sys.path = {[str(PACKAGE.parent), *sys.path]!r}\n"
        f"before = set(sys.modules)\n{program}\n"
        "print(*sorted(set(sys.modules) - before))"
    )
    process = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, timeout=30
    )
    assert process.returncode == 0, process.stderr
    return set(process.stdout.split())


class TestLateImports:
    """Programs that start often, such as one read in a shell, pay for each module each time."""

    @pytest.mark.parametrize(
        ("program", "needs", "unwanted"),
        [
            ("import libmodbus_py", {"late"}, {"client", "ports", "protocol"}),
            (
                "from libmodbus_py import Client",
                # What is compiled is wanted, so that it fails at once where it lacks; libmodbus is
                # for serial ports and servers.
                {"client.functions_blocking", "protocol._scan"},
                {
                    *("binding", "client.connection", "client.line", "client.asyncio_driver"),
                    *("maps", "ports.endpoint", "ports.serial", "ports.tls", "security"),
                    *("protocol.pdu.reads", "protocol.pdu.writes", "protocol.pdu.interface"),
                    *("protocol.values", "protocol.tables"),
                },
            ),
            (
                "from libmodbus_py import Client; Client('tcp://127.0.0.1').close()",
                {"client.options", "ports.endpoint"},
                {"client.line", "maps", "ports.serial", "protocol.pdu.writes"},
            ),
            (
                "from libmodbus_py import AsyncClient",
                {"client.functions_async", "client.asyncio_driver"},
                {"client.line", "maps", "ports.endpoint", "protocol.values"},
            ),
            (
                "from libmodbus_py import Device, Mapping, Server; Server(Device(Mapping(1)))",
                {"server.serving", "device.mapping"},
                {
                    *("maps", "security", "device.state", "server.audit"),
                    *("server.serial", "server.tls", "ports.serial", "ports.tls", "ports.unix"),
                },
            ),
            (
                "from libmodbus_py import Client; Client('rtu:///dev/null').close()",
                {"ports.serial", "protocol.pdu.function_codes", "binding._libmodbus"},
                {"maps", "protocol.values", "client.asyncio_driver"},
            ),
            (
                "from libmodbus_py import pdu; pdu.ReadHoldingRegisters(0, 1).encode()",
                {"protocol.pdu.reads"},
                {"client", "protocol.pdu.writes", "protocol.pdu.serial", "protocol.framing"},
            ),
        ],
    )
    def test_a_program_imports_few_modules(self, program: str, needs: set[str], unwanted: set[str]):
        modules = imported_by(program)
        if "AsyncClient" not in program and "Server" not in program:
            assert not modules & SLOW
        assert needs <= {name.removeprefix("libmodbus_py.") for name in modules}
        assert not {f"libmodbus_py.{name}" for name in unwanted} & modules

    def test_importing_the_client_needs_no_dataclasses(self) -> None:
        """They bring inspect, and with it half of what compiles Python."""
        modules = imported_by("from libmodbus_py import Client")
        assert not modules & {"dataclasses", "inspect", "urllib.parse"}

    def test_one_read_imports_one_kind_of_request(self) -> None:
        modules = imported_by(
            "import socket, threading\n"
            "from libmodbus_py import Client\n"
            "there = socket.create_server(('127.0.0.1', 0))\n"
            "def answer():\n"
            "    here, _ = there.accept()\n"
            "    asked = here.recv(12)\n"
            "    here.sendall(asked[:4] + bytes([0, 5]) + asked[6:8] + bytes([2, 1, 2]))\n"
            "thread = threading.Thread(target=answer)\n"
            "thread.start()\n"
            "with Client('tcp://127.0.0.1:%d' % there.getsockname()[1], timeout=20) as plc:\n"
            "    assert plc.read_holding_registers(0, 1) == [0x102]\n"
            "thread.join()\n"
        )
        kinds = {name for name in modules if name.startswith("libmodbus_py.protocol.pdu.")}
        own = ("request", "reads")
        assert kinds == {f"libmodbus_py.protocol.pdu.{name}" for name in own}

    def test_a_list_of_maps_imports_neither_client_nor_scan(self) -> None:
        modules = imported_by("from libmodbus_py.cli.main import main\nmain(['map', 'list'])")
        assert "libmodbus_py.cli.ask.map" in modules
        unwanted = ("client.blocking", "maps.point", "tools.scan.probe")
        assert not {f"libmodbus_py.{name}" for name in unwanted} & modules

    def test_importing_security_imports_ssl(self) -> None:
        assert "ssl" in imported_by("from libmodbus_py import Security")


HEADERS = [
    Path("/usr/include/modbus") / name for name in ("modbus.h", "modbus-tcp.h", "modbus-rtu.h")
]
needs_headers = pytest.mark.skipif(
    not all(path.exists() for path in HEADERS), reason="libmodbus-dev is not installed"
)


def header_text() -> str:
    text = "\n".join(path.read_text(errors="replace") for path in HEADERS if path.exists())
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def declared_functions() -> set[str]:
    declarations = re.findall(r"^MODBUS_API\b([^;]*);", header_text(), re.MULTILINE)
    return {
        match[1]
        for declaration in declarations
        if (match := re.search(r"(modbus_\w+)\s*\(", declaration))
    }


def declared_constants() -> set[str]:
    """Macros that have a value and no arguments, and the members of enums."""
    text = header_text()
    macros = set(re.findall(r"^#\s*define\s+((?:MODBUS|EMB)\w*)[ \t]+\(?[\w(]", text, re.MULTILINE))
    enums = " ".join(re.findall(r"\benum\b[^{;]*\{([^}]*)\}", text))
    members = set(re.findall(r"\b(MODBUS_\w+)\s*(?:=[^,]*)?(?:,|$)", enums))
    return (macros | members) - {"MODBUS_API", "MODBUS_BEGIN_DECLS", "MODBUS_END_DECLS"}


@needs_headers
class TestHeaders:
    def test_the_parser_of_headers_finds_functions_and_constants(self) -> None:
        """Else the tests below would pass on nothing."""
        assert len(declared_functions()) > 60
        assert {"modbus_read_bits", "modbus_new_rtu", "modbus_tcp_pi_accept"} < declared_functions()
        assert {
            "EMBXILFUN",
            "MODBUS_MAX_READ_BITS",
            "MODBUS_RTU_RS485",
            "MODBUS_ERROR_RECOVERY_LINK",
            "MODBUS_EXCEPTION_GATEWAY_TARGET",
        } < declared_constants()

    def test_every_function_of_the_headers_exists(self) -> None:
        missing = sorted(name for name in declared_functions() if not hasattr(lib, name))
        assert not missing, f"not in low_level.lib: {', '.join(missing)}"

    def test_every_other_constant_of_the_headers_exists(self) -> None:
        """The docstring of low_level: everything in the headers, under its C name."""
        missing = sorted(name for name in declared_constants() if not hasattr(lib, name))
        assert not missing, f"not in low_level.lib: {', '.join(missing)}"


NEWER: dict[str, tuple[Any, ...]] = {
    "modbus_enable_quirks": (0,),
    "modbus_disable_quirks": (0,),
    "modbus_send_raw_request_tid": (b"\1\3\0\0\0\1", 6, 7),
    "modbus_proxy": (ffi.NULL, bytes.fromhex("0001 0000 0006 01 03 0000 0001"), 12),
}
NEED_MORE = {"modbus_send_raw_request_tid", "modbus_proxy"}
"""Those of them that fail here, without a connection or a second context."""


class TestLowLevel:
    def test_loaded_version_is_that_of_the_library(self) -> None:
        version = loaded_version()
        assert len(version) == 3
        assert version >= (3, 1, 0)
        assert version[0] == lib.libmodbus_version_major

    @pytest.mark.parametrize("name", NEWER)
    def test_newer_functions_work_or_say_that_the_library_lacks_them(self, name: str) -> None:
        library = ctypes.CDLL("libmodbus.so.5")  # by its symbols, apart from the package
        context = ffi.gc(lib.modbus_new_tcp(b"127.0.0.1", 1502), lib.modbus_free)
        assert context != ffi.NULL
        ffi.errno = 0
        result = getattr(lib, name)(context, *NEWER[name])
        if not hasattr(library, name):
            assert (result, ffi.errno) == (-1, errno.ENOSYS)
        elif name in NEED_MORE:
            assert result == -1
            assert ffi.errno != errno.ENOSYS
        else:
            assert result == 0

    def test_newer_functions_refuse_an_empty_context(self) -> None:
        for name, arguments in NEWER.items():
            assert getattr(lib, name)(ffi.NULL, *arguments) == -1

    def test_constants_are_those_of_the_protocol(self) -> None:
        assert lib.MODBUS_MAX_READ_BITS == 2000
        assert lib.MODBUS_MAX_WRITE_BITS == 1968
        assert lib.MODBUS_MAX_READ_REGISTERS == 125
        assert lib.MODBUS_MAX_WRITE_REGISTERS == 123
        assert lib.MODBUS_MAX_WR_WRITE_REGISTERS == 121
        assert lib.MODBUS_MAX_PDU_LENGTH == 253
        assert lib.MODBUS_TCP_MAX_ADU_LENGTH == 260
        assert lib.MODBUS_RTU_MAX_ADU_LENGTH == 256

    def test_public_names_of_low_level_are_ffi_lib_and_loaded_version(self) -> None:
        assert low_level.__all__ == ["ffi", "lib", "loaded_version"]


def import_from(directory: Path) -> subprocess.CompletedProcess[str]:
    """Without site, so that no editable installation lends its compiled module."""
    backend = importlib.import_module("_cffi_backend").__file__ or ""
    return subprocess.run(
        [sys.executable, "-S", "-c", "from libmodbus_py import Client, Mapping"],
        cwd=directory,
        env={**os.environ, "PYTHONPATH": str(Path(backend).parent)},
        capture_output=True,
        text=True,
        check=False,
        timeout=50,
    )


def copied_package(directory: Path) -> Path:
    shutil.copytree(
        PACKAGE, directory / "libmodbus_py", ignore=shutil.ignore_patterns("*.so", "__pycache__")
    )
    return directory / "libmodbus_py"


def copied_modules(package: Path) -> Path:
    """Copy what is compiled, too; give the one that needs libmodbus."""
    for folder, name in (("protocol", "_scan"), ("binding", "_libmodbus")):
        module = Path(importlib.import_module(f"libmodbus_py.{folder}.{name}").__file__ or "")
        shutil.copy(module, package / folder)
    return module


class TestImportErrors:
    @pytest.mark.parametrize("missing", ["protocol/_scan", "binding/_libmodbus"])
    def test_without_a_compiled_module_the_error_names_the_package(self, tmp_path, missing) -> None:
        package = copied_package(tmp_path)
        copied_modules(package)
        for module in package.glob(f"{missing}.*"):
            module.unlink()
        run = import_from(tmp_path)
        assert run.returncode == 1
        last = run.stderr.splitlines()[-1]
        assert last.startswith("ImportError: libmodbus_py is not built")
        assert "libmodbus-dev" in last

    def test_without_libmodbus_the_error_says_what_to_install(self, tmp_path: Path) -> None:
        """The real loader, on a module that wants a library which no system has."""
        package = copied_package(tmp_path)
        module = copied_modules(package)
        code = module.read_bytes()
        assert code.count(b"libmodbus.so.5") >= 1
        (package / "binding" / module.name).write_bytes(
            code.replace(b"libmodbus.so.5", b"libmodbus.so.0")
        )
        run = import_from(tmp_path)
        assert run.returncode == 1
        last = run.stderr.splitlines()[-1]
        assert last.startswith("ImportError: ")
        assert "apt install libmodbus5" in last
        assert "libmodbus.so.0" in last

    def test_a_complete_copy_of_the_package_can_be_imported(self, tmp_path: Path) -> None:
        """Else the two tests above would prove nothing."""
        copied_modules(copied_package(tmp_path))
        run = import_from(tmp_path)
        assert (run.returncode, run.stderr) == (0, "")


TRANSACTION: dict[str, Any] = {
    "unit": 17,
    "function": 3,
    "asked": "ReadHoldingRegisters(address=1, count=2)",
    "sent": b"\1\2",
    "received": b"\3",
}


def all_errors() -> list[ModbusError]:
    examples: list[ModbusError] = [ExceptionResponse.of(code, **TRANSACTION) for code in range(256)]
    for name in errors.__all__:
        kind = getattr(errors, name)
        examples.append(kind("the reason", **TRANSACTION))
        examples.append(kind())
    return examples


ATTRIBUTES = ["unit", "function", "asked", "sent", "received", "args"]


def seen(error: ModbusError) -> dict[str, Any]:
    own = ATTRIBUTES + ["code"] * hasattr(error, "code") + ["errno"] * hasattr(error, "errno")
    return {name: getattr(error, name) for name in own} | {"text": str(error)}


def pickled(error: ModbusError) -> ModbusError:
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        error = pickle.loads(pickle.dumps(error, protocol))
    return error


class TestErrors:
    @pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickled])
    def test_copies_of_errors_keep_all_attributes(self, duplicate: Any) -> None:
        for error in all_errors():
            double = duplicate(error)
            assert type(double) is type(error)
            assert seen(double) == seen(error)

    @pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickled])
    def test_copies_of_errors_keep_the_errno(self, duplicate: Any) -> None:
        error = ModbusConnectionError("refused", errno=errno.ECONNREFUSED, **TRANSACTION)
        assert error.errno == errno.ECONNREFUSED
        assert seen(duplicate(error)) == seen(error)

    def test_every_error_names_unit_function_and_request(self) -> None:
        for error in all_errors():
            if error.unit is not None:
                assert str(error).startswith(
                    "unit 17, function 3, ReadHoldingRegisters(address=1, count=2): "
                )

    def test_errors_without_a_transaction_give_the_reason_alone(self) -> None:
        assert str(errors.FrameError("the reason")) == "the reason"
        error = errors.FrameError("the reason")
        assert [getattr(error, name) for name in ATTRIBUTES[:5]] == [None, None, "", b"", b""]

    def test_errors_can_be_caught_as_os_errors(self) -> None:
        assert issubclass(ModbusTimeoutError, TimeoutError)
        assert issubclass(ModbusConnectionError, ConnectionError)
        assert not issubclass(errors.FrameError, OSError)
        for name in errors.__all__:
            assert issubclass(getattr(errors, name), ModbusError)

    def test_exceptions_raised_in_a_server_have_their_code(self) -> None:
        for code in (*range(1, 9), 10, 11):
            kind = type(ExceptionResponse.of(code))
            assert kind is not ExceptionResponse
            assert kind().code == kind.code == code
            assert f"(exception {code})" in str(kind())
        assert str(errors.IllegalDataValue("too hot")) == "too hot"
        assert ExceptionResponse(code=99).code == 99
        assert type(ExceptionResponse.of(9)) is ExceptionResponse
