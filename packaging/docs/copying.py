"""
What the copy buttons of the documentation copy: of a session in a terminal, the commands alone.
"""

from __future__ import annotations

import html
import re

# The theme copies what `data-copy` says, if a block has it.
SESSION = re.compile(r'<div class="language-console highlight">(.*?)</div>', re.DOTALL)


def with_commands(page: str) -> str:
    """Return a page whose sessions have their commands as text to copy."""

    def changed(found: re.Match[str]) -> str:
        shown = html.unescape(re.sub(r"<[^>]+>", "", found[1]))
        commands = html.escape("\n".join(commands_of(shown)))
        return found[0].replace("highlight", f'highlight" data-copy="{commands}', 1)

    return SESSION.sub(changed, page)


def commands_of(session: str) -> list[str]:
    """Return what is typed in a session: lines behind "$ ", and those that continue them."""
    commands: list[str] = []
    goes_on = False
    for line in session.splitlines():
        if line.startswith("$ "):
            commands.append(line[2:])
        elif goes_on:
            commands.append(line.removeprefix("> "))
        goes_on = (goes_on or line.startswith("$ ")) and line.endswith("\\")
    return commands
