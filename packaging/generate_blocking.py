"""
Makes the methods of the blocking client of those of `AsyncClient`: client/NAME_blocking.py of each
client/NAME_async.py, without async and await. usage: generate_blocking.py [--check]
"""

from __future__ import annotations

import io
import re
import sys
import tokenize
from pathlib import Path

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "libmodbus_py" / "client"

NAMES = {
    "AsyncioDriver": "BlockingDriver",
    "asyncio_driver": "blocking_driver",
    "__aiter__": "__iter__",
    "__anext__": "__next__",
    "StopAsyncIteration": "StopIteration",
    "AsyncClient": "Client",
}
"""What changes, besides names that begin with Async or end with _async."""


def blocking(source: str, name: str) -> str:
    """Return the text of a file without async and await; texts and comments stay as they are."""
    lines = source.splitlines(keepends=True)
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    for token in reversed([*tokens]):  # from the end, so that places stay right
        if token.type not in (tokenize.NAME, tokenize.STRING):
            continue
        (row, start), (_, end) = token.start, token.end
        line = lines[row - 1]
        if token.string in ("async", "await"):
            lines[row - 1] = line[:start] + line[end:].lstrip(" ")
        elif re.fullmatch(r'\w+|"\w+"', token.string):  # a name, even in quotes
            lines[row - 1] = line[:start] + re.sub(r"\w+", _renamed, token.string) + line[end:]
    head = f"# Generated from {name} by packaging/generate_blocking.py; do not edit.\n"
    text = re.sub(r"\bAwaitable\[(\w+)\]", r"\1", "".join(lines))  # what is awaited is here
    return head + text.replace("import Awaitable, ", "import ")


def _renamed(found: re.Match[str]) -> str:
    name = found[0]
    if name in NAMES:
        return NAMES[name]
    return re.sub("_async$", "_blocking", re.sub("^Async(?=[A-Z])", "Blocking", name))


def outdated(*, write: bool) -> list[str]:
    """Return the files that are not what the generator makes; make them so with `write`."""
    made = {
        source.with_name(source.name.replace("_async", "_blocking")): source
        for source in FOLDER.glob("*_async.py")
    }
    found = []
    for path, source in made.items():
        text = blocking(source.read_text(encoding="utf-8"), source.name)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            found.append(str(path.relative_to(ROOT)))
            if write:
                path.write_text(text, encoding="utf-8")
    return sorted(found)


def main() -> int:
    is_check = sys.argv[1:] == ["--check"]
    found = outdated(write=not is_check)
    for each in found:
        print(f"{each}: {'not what generate_blocking.py makes' if is_check else 'written'}")
    return int(is_check and bool(found))


if __name__ == "__main__":
    sys.exit(main())
