"""
The examples: a slave, and a client that writes random values, with Debian's example as another one.
"""

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.c_programs import compile_c

ROOT = Path(__file__).parents[2]
DEBIAN = Path("/usr/share/doc/libmodbus-dev/examples/random-test-client.c")


@contextlib.contextmanager
def slave() -> Iterator[int]:
    """Run the slave until Ctrl-C, and yield its port."""
    command = [sys.executable, ROOT / "examples" / "slave.py", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline().split()[-1])
            assert process.stdout.readline().startswith("a master: 127.0.0.1:")
            assert "closed by the other side" in process.stdout.readline()
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=30)
    assert process.returncode == 0


def test_the_random_client_reads_from_the_slave_what_it_has_written() -> None:
    with slave() as port:
        done = subprocess.run(
            [sys.executable, ROOT / "examples" / "random_client.py", str(port)],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert (done.stdout, done.returncode) == ("600 reads, 0 of them wrong\n", 0), done.stderr


@pytest.mark.slow
def test_the_random_client_of_debian_reads_so_too(tmp_path: Path) -> None:
    if not DEBIAN.exists():
        pytest.skip(f"{DEBIAN} is not there: this system installs no documentation")
    with slave() as port:
        copy = tmp_path / DEBIAN.name
        text = DEBIAN.read_text(encoding="utf-8")
        assert ", 1502)" in text
        copy.write_text(text.replace(", 1502)", f", {port})"), encoding="utf-8")
        client = compile_c(copy, tmp_path / "client")
        done = subprocess.run([client], capture_output=True, text=True, timeout=60)
    assert "Test: SUCCESS" in done.stdout
