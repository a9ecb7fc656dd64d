"""
The README's code does what its comments say.
"""

from __future__ import annotations

import contextlib
import io
import re
import socket
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def test_the_first_example_prints_what_it_says() -> None:
    example = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert example is not None
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(example[1].replace("1502", port), {})
    assert printed.getvalue().splitlines() == [
        "[555, 0, 100]",
        "[[1711, 1214, 4109]]",
        "unit 17, function 6, WriteRegister(address=2449, value=999):"
        " illegal data address (exception 2)",
    ]
