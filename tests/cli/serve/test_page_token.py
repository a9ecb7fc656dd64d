"""
--page-token: a page whose URL stays the same, so that a bookmark survives a restart.
"""

from __future__ import annotations

import urllib.error
import urllib.request
from pathlib import Path

import pytest

from tests.support.cases import each_case
from tests.support.commands import Started, run

TOKEN = "Bookmarked-by_the-plant-2026"


def url_of_page(*options: object, **environment: str) -> str:
    """Start a server, open its page, and return the URL."""
    command = ("serve", "tcp://127.0.0.1:0", "--page", "127.0.0.1:0", *options)
    with Started(*command, environment=environment) as process:
        process.stdout.readline()
        url = process.stdout.readline().removeprefix("page on ").rstrip("\n")
        with urllib.request.urlopen(url) as answer:
            assert answer.status == 200
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(url[:-1])
        process.terminate()
        process.wait()
    return url


def test_the_token_of_a_file_or_the_environment_is_used(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    assert url_of_page("--page-token", file).endswith(f"?token={TOKEN}")
    assert url_of_page(LIBMODBUS_PY_PAGE_TOKEN=TOKEN).endswith(f"?token={TOKEN}")
    assert TOKEN not in url_of_page()


@each_case(
    ("content", "said"),
    [
        ("", "token must have 22 or more letters, digits, - or _"),
        ("short", "token must have 22 or more"),
        ("x" * 1001, "token must have 22 or more"),
        (f"{TOKEN}&x=1", "token must have 22 or more"),
        (f"{TOKEN}\nanother", "token must have 22 or more"),
        (None, "No such file or directory"),
    ],
)
def test_a_wrong_token_is_told_and_not_shown(
    tmp_path: Path, content: str | None, said: str
) -> None:
    file = tmp_path / "token"
    file.unlink(missing_ok=True)
    if content is not None:
        file.write_text(content)
    done = run("serve", "tcp://127.0.0.1:0", "--page", "127.0.0.1:0", "--page-token", file)
    assert done.code == 2
    assert said in done.err
    assert done.err.count("\n") == 1
    assert TOKEN not in done.err


def test_a_token_without_a_page_is_refused(tmp_path: Path) -> None:
    done = run("serve", "tcp://127.0.0.1:0", "--page-token", tmp_path)
    assert (done.code, "--page-token needs --page" in done.err) == (2, True)
