"""
A headless Chromium of its own, driven by Selenium through Debian's chromedriver.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from typing import Any

__all__ = ["browser", "missing"]

PROGRAMS = ("chromium", "chromedriver")

# It is root's where tests are run in containers; it fetches nothing of its own.
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
    "--hide-scrollbars",
    "--force-color-profile=srgb",
)


def missing() -> str:
    """Say what is not installed, if anything."""
    lacking = [each for each in PROGRAMS if shutil.which(each) is None]
    return f"{' and '.join(lacking)} not installed (Debian: chromium, chromium-driver)" * bool(
        lacking
    )


@contextlib.contextmanager
def browser(width: int = 1200, height: int = 800) -> Iterator[Any]:
    """Start one; it is gone, with all it wrote, when the block is left."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for each in (*OPTIONS, f"--user-data-dir={profile}"):
            options.add_argument(each)
        driver = webdriver.Chrome(options, Service(shutil.which("chromedriver")))
        try:
            resize(driver, width, height)
            yield driver
        finally:
            driver.quit()


def resize(driver: Any, width: int, height: int) -> None:
    """Exactly, also where windows cannot be so narrow."""
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
