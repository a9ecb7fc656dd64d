"""
The page through nginx and Caddy, with the files in deploy/: under a path, with the proxy's address
in Host and Origin.
"""

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from libmodbus_py.page import live_page
from tests.support.programs import HeldPort, listens, program
from tests.tools.page.test_page_attacks import CHANGE
from tests.tools.page.watching import Visitor, make_server

pytestmark = pytest.mark.slow

DEPLOY = Path(__file__).parents[3] / "deploy"
OUTER = "https://plant.example/modbus"


def without_tls_and_password(text: str, *, port: int, page: int) -> str:
    """Return the configuration of a proxy for these ports of 127.0.0.1, reached over HTTP."""
    text = re.sub(r"(?m)^\s*(ssl|auth_)\w+ .*\n|^\s*basicauth \{[^}]*\}\n", "", text)
    text = text.replace("listen 443 ssl", f"listen 127.0.0.1:{port}")
    text = text.replace("\nplant.example {", f"\nhttp://plant.example:{port} {{\n\tbind 127.0.0.1")
    return text.replace("127.0.0.1:8080", f"127.0.0.1:{page}")


NGINX = """
daemon off; master_process off; pid {folder}/pid; error_log {folder}/errors;
events {{}}
http {{
    access_log off; client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/f; uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;
    {servers}
}}
"""


@contextmanager
def proxy(name: str, folder: Path, port: int, page: int) -> Iterator[None]:
    """Run nginx or Caddy with its file in deploy/, between these ports, until the block ends."""
    file = DEPLOY / {"nginx": "nginx-page.conf", "caddy": "Caddyfile"}[name]
    text = without_tls_and_password(file.read_text(), port=port, page=page)
    config = folder / "config"
    if name == "nginx":
        config.write_text(NGINX.format(folder=folder, servers=text))
        words = [program("nginx"), "-p", folder, "-e", folder / "errors", "-c", config]
    else:
        config.write_text(f"{{\n\tadmin off\n\tauto_https off\n}}\n{text}")
        words = [program("caddy"), "run", "--adapter", "caddyfile", "--config", config]
    home = {"HOME": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    with subprocess.Popen(words, env=home, stderr=subprocess.DEVNULL) as process:
        try:
            listens(process, port)
            yield
        finally:
            process.kill()


@pytest.mark.parametrize("name", ["nginx", "caddy"])
def test_the_page_works_through_a_proxy(name: str, tmp_path: Path) -> None:
    with (
        HeldPort() as outer,
        HeldPort() as inner,
        live_page(make_server(), port=inner.number, url=OUTER) as page,
        proxy(name, tmp_path, outer.number, inner.number),
    ):
        visitor = Visitor(page.url)
        visitor.headers |= {"Origin": "https://plant.example", "Host": "plant.example"}
        del visitor.headers["Cookie"]
        visitor.address = "127.0.0.1", outer.number
        status, headers, data = visitor.ask("GET", f"/modbus/?{urlsplit(page.url).query}")
        assert (status, b'src="scripts/page.js"' in data) == (200, True)
        visitor.headers["Cookie"] = headers["Set-Cookie"].partition(";")[0]
        assert visitor.ask("GET", "/modbus/scripts/page.js")[0] == 200
        assert visitor.ask("POST", "/modbus/value", CHANGE)[0] == 200
        stranger = visitor.ask("POST", "/modbus/value", CHANGE, Origin="https://evil.example")
        assert stranger[0] == 403
