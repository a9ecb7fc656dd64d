"""
The pages of the API, which packaging/docs/reference.py makes: each public name has a heading, and
what a program constructs or calls comes first.
"""

import importlib.util
import inspect
import re
import runpy
from pathlib import Path

import pytest

from libmodbus_py import AsyncClient, Client, Server
from tests.docs.documents import ROOT
from tests.support.cases import each_case

REFERENCE = runpy.run_path(str(ROOT / "packaging" / "docs" / "reference.py"))
TEMPLATES = sorted((ROOT / "packaging" / "docs" / "api").glob("*.md"))
TEXT = "".join(path.read_text() for path in sorted((ROOT / "docs" / "api").glob("*.md")))
HEADINGS = set(re.findall(r"(?m)^#+ (\S+)$", TEXT))

MODULES = (
    *("bound", "device_file", "errors", "fleet", "framing", "listen", "low_level", "page", "pdu"),
    *("prometheus", "scan", "serve", "testing", "values"),
)

RECEIVED = re.compile(
    r"Statistics$|Error$|^(Access|AuditEvent|Caller|ClientRequest|Extent|FleetFile|FoundUnit|HistoricalValue"
    r"|Listener|NamedValue|NoValue|Reading|Running|Scan|Search|Summary|Transaction|ValueChange)$"
)
"""What a program gets from calls and hooks, and does not make."""


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.stem)
def test_functions_that_receive_stand_after_functions_that_make(path: Path) -> None:
    if path.stem == "errors":
        return
    for part in path.read_text().split("\n## "):
        names = [name.rpartition(".")[2] for name in re.findall(r"(?m)^::: (\S+)$", part)]
        received = [bool(RECEIVED.search(name)) for name in names]
        assert received == sorted(received), names


def test_each_public_name_has_a_heading() -> None:
    modules = [f"libmodbus_py.{name}" for name in MODULES]
    if importlib.util.find_spec("modbus_connection"):  # Python 3.11 has none
        modules.append("libmodbus_py.modbus_connection")
    names = {
        name
        for module in ("libmodbus_py", *modules)
        for name in importlib.import_module(module).__all__
        if name not in MODULES and name != "__version__"
    }
    assert names - HEADINGS == set()


@pytest.mark.parametrize("cls", [Client, Server])
def test_each_method_has_a_heading_and_its_docstring(cls: type) -> None:
    for name, member in inspect.getmembers(cls):
        if name[0] != "_" and inspect.getdoc(member):
            assert f"{cls.__name__}.{name}" in HEADINGS
            first = (inspect.getdoc(member) or "").splitlines()[0]
            assert first.replace("``", "`") in TEXT


def test_methods_of_the_asyncio_client_are_those_of_the_blocking_one() -> None:
    (names,) = re.findall("These are as in `Client`; the methods are awaited: (.*)\n", TEXT)
    public = {name for name in dir(AsyncClient) if name[0] != "_"}
    assert public == {*re.findall(r"`(\w+)`", names), "close"}


def test_no_private_name_has_a_heading() -> None:
    assert [name for name in HEADINGS if re.search(r"(^|\.)_", name)] == []


SOURCE = '''
class Shown(Base[int]):
    """
    Say ``something``.

    Args:
        first: a number,
            1 or more.

    Raises:
        TypeError, ValueError: it is wrong.
    """

    def __init__(self, first: "int", /, *more: str, third: bool = False, **wrong: None) -> None:
        pass

    def _hidden(self) -> None:
        """Do nothing."""

    @property
    def size(self) -> int:
        """The size."""
'''

PAGE = """\
## Shown

```python
class Shown(first: int, /, *more: str, third: bool = False)
```

Say `something`.

**Arguments**

- `first`: a number,
  1 or more.

**Exceptions**

- `TypeError`, `ValueError`: it is wrong.

### Shown.size

```python
size: int
```

The size.
"""


def test_a_class_is_shown_with_its_signature_and_docstring(tmp_path, monkeypatch) -> None:
    (tmp_path / "libmodbus_py").mkdir()
    (tmp_path / "libmodbus_py" / "sample.py").write_text(SOURCE)
    monkeypatch.setitem(REFERENCE["file_of"].__globals__, "ROOT", tmp_path)
    assert REFERENCE["of_name"]("libmodbus_py.sample.Shown") == PAGE


@each_case("path", ["libmodbus_py.nothing", "libmodbus_py.Client.nothing", "os.path"])
def test_a_name_that_does_not_exist_is_an_error(path: str) -> None:
    with pytest.raises(LookupError, match=f"{path} does not exist"):
        REFERENCE["of_name"](path)
