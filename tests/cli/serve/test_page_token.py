"""
--page-token: a page whose URL stays the same, so that a bookmark survives a restart.
"""

import re
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from tests.support.cases import each_case
from tests.support.commands import PAGE_TOKEN, Started, on_terminal, page_url, run

(TOKEN,) = PAGE_TOKEN.values()


SERVE = ("serve", "tcp://127.0.0.1:0", "--page", "127.0.0.1:0")


@pytest.mark.parametrize("where", ["file", "environment"])
def test_a_token_that_was_given_opens_the_page_and_is_not_printed(
    where: str, tmp_path: Path
) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    file.chmod(0o600)
    options = ("--page-token", file) if where == "file" else ()
    environment = PAGE_TOKEN if where == "environment" else {}
    with Started(*SERVE, *options, "--log", "debug", environment=environment) as process:
        process.stdout.readline()
        url = page_url(process.stdout.readline())
        with urllib.request.urlopen(url) as answer:
            assert answer.status == 200
        with pytest.raises(urllib.error.HTTPError, match="403") as caught:
            urllib.request.urlopen(url[:-1])
        caught.value.close()
        process.terminate()
        assert TOKEN not in process.stdout.read() + process.stderr.read()


def test_a_new_token_is_printed_on_a_terminal() -> None:
    shows_url = re.compile(r"page on (http://\S+\?token=\S{32})\s").search
    with on_terminal(*SERVE) as terminal:
        found = shows_url(terminal.until(lambda text: shows_url(text) is not None))
        assert found
        with urllib.request.urlopen(found[1]) as answer:
            assert answer.status == 200


@each_case(
    ("content", "mode", "said"),
    [
        ("", 0o640, "token must have 22 or more letters, digits, - or _"),
        ("short", 0o640, "token must have 22 or more"),
        ("x" * 1001, 0o640, "token must have 22 or more"),
        (f"{TOKEN}&x=1", 0o640, "token must have 22 or more"),
        (f"{TOKEN}\nanother", 0o640, "token must have 22 or more"),
        ("\udcff" * 22, 0o640, "token must have 22 or more"),
        (TOKEN, 0o604, "file: all users of this machine can read this secret"),
        (None, 0, "No such file or directory"),
    ],
)
def test_a_wrong_token_is_told_and_not_shown(
    tmp_path: Path, content: str | None, mode: int, said: str
) -> None:
    file = tmp_path / "file"
    file.unlink(missing_ok=True)
    if content is not None:
        file.write_bytes(content.encode(errors="surrogateescape"))
        file.chmod(mode)
    done = run(*SERVE, "--page-token", file)
    assert done.code == 2
    assert said in done.err
    assert done.err.count("\n") == 1
    assert TOKEN not in done.err
