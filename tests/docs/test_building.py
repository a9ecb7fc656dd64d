"""How the documentation is built from its pages: links, copy buttons, search, pictures."""

import json
import re
import runpy
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tests.docs.documents import DOCUMENTS, ROOT

SCRIPTS = ROOT / "packaging" / "docs"
ADDRESS = "https://forge.example/group/libmodbus-py"


def loaded(name: str) -> Any:
    sys.path.insert(0, str(SCRIPTS))
    try:
        return import_module(name)
    finally:
        sys.path.remove(str(SCRIPTS))


TEXT_FILES = (".md", ".py", ".toml", ".in", ".service", ".yml", ".cfg", ".sh")


def test_no_file_names_an_address_that_does_not_exist() -> None:
    """As long as pyproject.toml names no repository, there is none to link to."""
    if loaded("links").repository(ROOT):
        pytest.skip("the repository has a public address")
    address = re.compile(
        r"git(hub|lab)(usercontent)?\.(com|io)/libmodbus-py|libmodbus-py\.github\.io"
    )
    files = runpy.run_path(str(ROOT / "packaging" / "deb.py"))["files"]()
    names = [
        name
        for name in files
        if name.endswith(TEXT_FILES) and address.search((ROOT / name).read_text())
    ]
    assert len(files) > 500
    assert names == []


PAGE = "[map](../../examples/meter.toml), [here](tls.md#roles), [units](../../deploy), [web](https://a.b)"


@pytest.mark.parametrize(
    ("address", "page"),
    [
        (
            "",
            "[map](../files/examples/meter.toml), [here](tls.md#roles), units, [web](https://a.b)",
        ),
        (
            ADDRESS,
            f"[map]({ADDRESS}/blob/main/examples/meter.toml), [here](tls.md#roles),"
            f" [units]({ADDRESS}/tree/main/deploy), [web](https://a.b)",
        ),
    ],
)
def test_links_out_of_the_pages_lead_to_the_repository_or_to_copies(address, page, tmp_path):
    links = loaded("links")
    assert links.prepared(PAGE, Path("how-to/x.md"), ROOT, tmp_path, address) == page
    assert (tmp_path / "files" / "examples" / "meter.toml").exists() == (not address)


def test_an_index_gets_absolute_links() -> None:
    text = "[a](docs/index.md#x) ![b](docs/page.png) [c](deploy) [d](https://e.f) [g](#h)"
    assert loaded("links").absolute(text, "", ROOT, ADDRESS) == (
        f"[a]({ADDRESS}/blob/main/docs/index.md#x) ![b]({ADDRESS}/raw/main/docs/page.png)"
        f" [c]({ADDRESS}/tree/main/deploy) [d](https://e.f) [g](#h)"
    )


def test_the_repository_address_comes_from_the_project_file(tmp_path: Path) -> None:
    file = tmp_path / "pyproject.toml"
    file.write_text(f'[project]\nname = "x"\n[project.urls]\nSource = "{ADDRESS}/"\n')
    assert loaded("links").repository(tmp_path) == ADDRESS


SESSION = """$ libmodbus-py serve tcp://127.0.0.1:1502 &
listening on tcp://127.0.0.1:1502
$ libmodbus-py read 'a "b"' \\
>     --json
  0  $ 5
"""


def test_the_commands_of_a_session_are_copied() -> None:
    assert loaded("copying").commands_of(SESSION) == [
        "libmodbus-py serve tcp://127.0.0.1:1502 &",
        "libmodbus-py read 'a \"b\"' \\",
        "    --json",
    ]


def test_copy_buttons_have_the_commands_without_prompts() -> None:
    """The theme copies the attribute data-copy of the block, or else all that it shows."""
    from html import escape, unescape

    html = escape(SESSION).replace("$ ", '<span class="gp">$ </span>')
    other = '<div class="language-python highlight"><pre><code>x</code></pre></div>'
    page = f'<div class="language-console highlight"><pre><code>{html}</code></pre></div>{other}'
    text = loaded("copying").with_commands(page)
    (commands,) = re.findall(r'<div class="language-console highlight" data-copy="([^"]*)">', text)
    assert unescape(commands).splitlines() == loaded("copying").commands_of(SESSION)
    assert text.endswith(other)


def item(location: str, title: str) -> dict[str, Any]:
    return {"location": location, "title": title, "text": "", "path": ["x"], "level": 2, "tags": []}


INDEX = json.dumps(
    {
        "config": {},
        "items": [
            item("api/clients/#note_answer", "note_answer"),
            item("api/servers/", "no answer"),
            item("troubleshooting/", "Troubleshooting"),
            item("troubleshooting/#lines", "Lines"),
        ],
    }
)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / "troubleshooting").mkdir()
    (tmp_path / "troubleshooting" / "index.html").write_text('<h2 id="lines">Lines</h2>')
    return tmp_path


def test_questions_come_first_and_api_names_last_in_searches(site: Path) -> None:
    searching = loaded("searching")
    questions = {"no answer": "troubleshooting/#lines"}
    assert searching.mistakes(INDEX, questions, site) == [
        "search: 'no answer' leads to api/servers/, not to troubleshooting/#lines"
    ]
    arranged = searching.arranged(INDEX, questions)
    locations = [load["location"] for load in json.loads(arranged)["items"]]
    assert locations == [
        *("troubleshooting/#lines", "troubleshooting/", "troubleshooting/#lines"),
        *("api/clients/#note_answer", "api/servers/"),
    ]
    assert searching.mistakes(arranged, questions, site) == []


def test_a_question_whose_page_does_not_exist_is_a_mistake(site: Path) -> None:
    searching = loaded("searching")
    for location in ("nowhere/", "troubleshooting/#nothing"):
        arranged = searching.arranged(INDEX, {"no answer": location})
        (mistake,) = searching.mistakes(arranged, {"no answer": location}, site)
        assert mistake == f"search: 'no answer' leads to {location}, which does not exist"


def test_questions_lead_to_pages_that_exist() -> None:
    questions = tomllib.loads((SCRIPTS / "asked.toml").read_text())
    assert {"no answer", "reconnect", "log to csv", "influxdb"} <= set(questions)
    for location in questions.values():
        page = location.partition("#")[0].rstrip("/")
        assert (ROOT / "docs" / f"{page}.md").exists() or (ROOT / "docs" / page).is_dir(), location


def install_blocks(path: Path) -> list[str]:
    return re.findall(
        r"```sh\n(sudo apt update && sudo apt install lib.*?)```", path.read_text(), re.DOTALL
    )


def test_one_block_of_the_documentation_installs_the_package() -> None:
    pages = [ROOT / "README.md", ROOT / "docs/how-to/install.md"]
    blocks = [install_blocks(page) for page in pages]
    assert blocks == [blocks[0]] * 2
    assert len(blocks[0]) == 1


SHOWN = "\x1b[1mtop\x1b[0m\r\nlow\r\n\x1b[2A\x1b[Jnew & \x1b[31mred\x1b[0m\r\nnext\x1b[K"


def test_a_terminal_is_drawn_as_it_looks_at_the_end() -> None:
    terminal = loaded("terminal")
    screen = terminal.Screen()
    screen.show(SHOWN)
    assert ["".join(entry for entry, _ in row) for row in screen.rows] == ["new & red", "next"]
    picture = terminal.picture("libmodbus-py read", screen)
    assert re.findall(r">([^<>\n]+)</text>", picture) == [
        *("$", " libmodbus-py read", "new &amp; ", "red", "next")
    ]
    assert 'fill="#ff7b72">red<' in picture


def test_the_picture_of_the_first_page_is_a_session() -> None:
    picture = (ROOT / "docs" / "watch.svg").read_text()
    assert "<title>libmodbus-py read tcp://127.0.0.1:1502 --map meter --watch 1</title>" in picture
    for text in ("voltage", "kWh", "frequency"):
        assert text in picture


DIAGRAMS = sorted((ROOT / "docs" / "diagrams").glob("*.txt"))


def test_the_diagrams_are_what_their_texts_say() -> None:
    """python packaging/docs/diagrams.py docs/diagrams draws them again."""
    diagrams = loaded("diagrams")
    assert len(DIAGRAMS) >= 4
    for path in DIAGRAMS:
        assert path.with_suffix(".svg").read_text() == diagrams.drawn(
            diagrams.read(path.read_text())
        )
    pages = "".join(path.read_text() for path in DOCUMENTS)
    assert [path.stem for path in DIAGRAMS if f"diagrams/{path.stem}.svg" not in pages] == []


def test_a_diagram_shows_its_boxes_and_lines() -> None:
    diagrams = loaded("diagrams")
    text = "title: T & U\ncolumn: a / small; b\ncolumn: c\na -- c: x\nc -- b\n"
    picture = diagrams.drawn(diagrams.read(text))
    assert "<title>T &amp; U</title>" in picture
    assert re.findall(r">([^<>\n]+)</text>", picture) == ["x", "a", "small", "b", "c"]
    assert picture.count("<line ") == 2


@pytest.mark.parametrize(
    ("text", "message"), [("column: a\na -- b\n", "'b' is in no column"), ("a b", "'a b': neither")]
)
def test_a_mistake_in_the_text_of_a_diagram_is_named(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        loaded("diagrams").read(text)
