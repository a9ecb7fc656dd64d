"""A headless Chromium, driven by Selenium through Debian's chromedriver, and who uses it."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support import programs
from tests.support.peers import until

PROGRAMS = {"chromium": "chromium", "chromedriver": "chromium-driver"}

PLACES = ((socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1"))

# Root must run Chromium without its sandbox, and so must users of most containers.
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-crash-reporter",
    # Over a port, chromedriver would look for it at "localhost", which not every machine knows.
    "--remote-debugging-pipe",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
)

# The origin of Chromium's own pages, which complain where there is no network.
OWN_PAGE = re.compile(r"(chrome|devtools)[a-z-]*://")


def missing() -> str:
    """Return what is not installed, and the Debian packages of it; nothing if all is."""
    lacking = programs.missing(*PROGRAMS)
    if not lacking:
        return ""
    packages = ", ".join(PROGRAMS[name] for name in lacking)
    return f"{' and '.join(lacking)} not installed (Debian: {packages})"


IN_BROWSER = [
    pytest.mark.skipif(bool(missing()), reason=missing()),
    pytest.mark.timeout(300),  # Chromium on a busy machine
]
"""The marks of tests that use a browser."""


@contextlib.contextmanager
def person_at(url: str = "about:blank", width: int = 1200, height: int = 800) -> Iterator[Person]:
    """Open a URL in a new browser; after the block it has ended, and all that it wrote is gone."""
    from selenium import webdriver
    from selenium.webdriver.chrome.remote_connection import ChromeRemoteConnection

    options = webdriver.ChromeOptions()
    options.binary_location = programs.program("chromium")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        _chromedriver(folder) as chromedriver,
    ):
        for entry in (*OPTIONS, f"--user-data-dir={folder}/profile"):
            options.add_argument(entry)
        connection = ChromeRemoteConnection(chromedriver, ignore_proxy=True)
        driver = webdriver.Remote(connection, options=options)
        try:
            person = Person(driver)
            person.resize(width, height)
            driver.get(url)
            yield person
        finally:
            driver.quit()


@contextlib.contextmanager
def _chromedriver(folder: str) -> Iterator[str]:
    """Run chromedriver at a free port, with a folder for HOME and temporary files."""
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("XDG_")},
        "HOME": folder,
        "TMPDIR": folder,
    }
    command = [programs.program("chromedriver"), f"--port={_free_port()}"]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        try:
            yield f"http://127.0.0.1:{_port(process.stdout)}"
        finally:
            process.terminate()


def _free_port() -> int:
    """
    Return a port that is free on 127.0.0.1 and on ::1, and that no program is given for port 0.

    For port 0, chromedriver has one chosen on ::1, and ends if it is taken on 127.0.0.1.
    """
    for port in range(10_000 + os.getpid() % 10_000, 32_000):
        if all(map(_is_free, PLACES, (port, port))):
            return port
    raise RuntimeError("no port is free")


def _is_free(place: tuple[int, str], port: int) -> bool:
    family, host = place
    try:
        with socket.socket(family) as trial:
            trial.bind((host, port))
    except OSError as error:
        return error.errno != errno.EADDRINUSE  # there may be no IPv6
    return True


def _port(output: Iterator[str]) -> int:
    lines = []
    for line in output:
        if match := re.search(r"on port (\d+)\.$", line.strip()):
            return int(match[1])
        lines.append(line)
    raise RuntimeError(f"chromedriver did not start: {''.join(lines)}")


class Person:
    """Looks, clicks and types."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def resize(self, width: int, height: int) -> None:
        """Set the size of the view, also to less than the least width of a window."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        command = {"cmd": "Emulation.setDeviceMetricsOverride", "params": metrics}
        self.driver.execute("executeCdpCommand", command)

    def complaints(self) -> list[str]:
        """Return what pages wrote to the browser's console since this was last asked."""
        entries = self.driver.execute("getLog", {"type": "browser"})["value"]
        messages = [entry["message"] for entry in entries]
        return [message for message in messages if not OWN_PAGE.match(message)]

    def run(self, script: str, *arguments: str) -> Any:
        """Return what a script in the page returns."""
        return self.driver.execute_script(script, *arguments)

    def focus(self, selector: str) -> None:
        self.run("document.querySelector(arguments[0]).focus()", selector)

    def focused(self, name: str) -> Any:
        """Return an attribute of the element that has the focus."""
        return self.driver.switch_to.active_element.get_attribute(name)

    def enters(self, selector: str, text: str) -> None:
        """Put a text in place of that in a field."""
        self.one(selector).clear()
        self.one(selector).send_keys(text)

    def all(self, selector: str) -> list[Any]:
        elements: list[Any] = self.driver.find_elements("css selector", selector)
        return elements

    def one(self, selector: str) -> Any:
        return until(lambda: self.all(selector))[0]

    def text(self, selector: str) -> str:
        """The text of an element, also where it is scrolled out of sight."""
        texts: str = self.run(
            "return [...document.querySelectorAll(arguments[0])].map(e => e.textContent).join('|')",
            selector,
        )
        return texts

    def attribute(self, selector: str, name: str) -> Any:
        """In one step, for the element may be drawn again between finding and asking it."""
        return self.run(
            "return document.querySelector(arguments[0])?.getAttribute(arguments[1])",
            selector,
            name,
        )

    def sees(self, selector: str, text: str) -> None:
        until(lambda: text in self.text(selector))

    def click(self, selector: str, text: str = "") -> None:
        from selenium.common.exceptions import StaleElementReferenceException

        def found() -> list[Any]:
            return [entry for entry in self.all(selector) if text in entry.text]

        def is_done() -> bool:
            try:
                until(found)[0].click()
            except StaleElementReferenceException:  # the element was drawn again at that time
                return False
            return True

        until(is_done)

    def types(self, *keys: str) -> None:
        """To whatever has the focus."""
        from selenium.webdriver import ActionChains

        ActionChains(self.driver).send_keys(*keys).perform()
