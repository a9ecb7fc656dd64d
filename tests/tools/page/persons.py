"""
Somebody who uses a page in a browser.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.tools.page.watching import until

__all__ = ["Person"]


class Person:
    """Looks, clicks and types."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def all(self, selector: str) -> list[Any]:
        found: list[Any] = self.driver.find_elements("css selector", selector)
        return found

    def one(self, selector: str) -> Any:
        return until(lambda: self.all(selector), 30)[0]

    def text(self, selector: str) -> str:
        """As it stands there, also where it is scrolled out of sight."""
        found: str = self.driver.execute_script(
            "return [...document.querySelectorAll(arguments[0])].map(e => e.textContent).join('|')",
            selector,
        )
        return found

    def attribute(self, selector: str, name: str) -> Any:
        """In one step, for the element may be drawn again between finding and asking it."""
        return self.driver.execute_script(
            "return document.querySelector(arguments[0])?.getAttribute(arguments[1])",
            selector,
            name,
        )

    def sees(self, selector: str, text: str) -> None:
        until(lambda: text in self.text(selector), 30)

    def click(self, selector: str, text: str = "") -> None:
        def found() -> list[Any]:
            return [each for each in self.all(selector) if text in each.text]

        self._retried(lambda: until(found, 30)[0].click())

    def types(self, *keys: str) -> None:
        """To whatever has the focus."""
        from selenium.webdriver import ActionChains

        ActionChains(self.driver).send_keys(*keys).perform()

    def _retried(self, act: Callable[[], None]) -> None:
        """The element that is clicked may be drawn again in that moment."""
        from selenium.common.exceptions import StaleElementReferenceException

        def is_done() -> bool:
            try:
                act()
            except StaleElementReferenceException:
                return False
            return True

        until(is_done, 30)
