"""InfluxDB for tests: version 1, as Debian 12 has it."""

import json
import os
import subprocess
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any

from tests.services.fleet.fleets import LONGEST
from tests.support.programs import HeldPort, listens, program

CONFIGURATION = """
reporting-disabled = true
bind-address = "127.0.0.1:0"
[meta]
dir = "{folder}/meta"
[data]
dir = "{folder}/data"
wal-dir = "{folder}/wal"
[monitor]
store-enabled = false
[http]
bind-address = "127.0.0.1:{port}"
"""


class Database:
    """An influxd with the database `plant`."""

    def __init__(self, folder: Path) -> None:
        self._held = HeldPort()
        self.port: int = self._held.number
        self.url = f"http://127.0.0.1:{self.port}"
        self._file = folder / "influxdb.conf"
        self._file.write_text(CONFIGURATION.format(folder=folder, port=self.port))
        self.process: subprocess.Popen[bytes]

    def start(self) -> None:
        environment = {**os.environ, "HOME": str(self._file.parent)}
        self.process = subprocess.Popen(
            [program("influxd"), "-config", str(self._file)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        listens(self.process, self.port)
        self.ask("CREATE DATABASE plant")

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        """Stop it, and give its port back."""
        self.stop()
        self._held.close()

    def ask(self, question: str) -> list[dict[str, Any]]:
        """Return the rows of a question, each by the names of the columns."""
        query = urllib.parse.urlencode({"db": "plant", "q": question})
        request = urllib.request.Request(f"{self.url}/query", query.encode())
        with urllib.request.urlopen(request, timeout=LONGEST) as answer:
            (result,) = json.load(answer)["results"]
        return [
            dict(zip(series["columns"], values, strict=True))
            for series in result.get("series", ())
            for values in series["values"]
        ]
