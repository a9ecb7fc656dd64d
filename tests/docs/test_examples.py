"""The runner of documents: what it takes, and what it does not let pass."""

from pathlib import Path

import pytest
from sybil import Example

from tests.docs.conftest import Isolated
from tests.docs.documents import Examples, read
from tests.docs.home import run_document
from tests.docs.python_blocks import matches
from tests.docs.shell_blocks import of_console, of_sh
from tests.support.cases import each_case


def test_a_document_runs(tmp_path: Path, isolated: Isolated) -> None:
    isolated(run_document, Path(__file__).parent / "example.md", tmp_path)


@pytest.mark.parametrize(
    ("block", "what"),
    [
        ("```python\n1 + 1  # 3\n```", "2 is not 3"),
        ("```python\nx = 1 + 1  # 3\n```", "2 is not 3"),
        ("```python\nprint(1 + 1)  # 3\n```", "printed is '2', not '3'"),
        ("```python\n[1, 2]  # [..., 3]\n```", "is not"),
        ("```python\nfor i in range(2):\n    i  # 0\n```", "1 is not 0"),
        ("```python\nnobody\n```", "not defined"),
        ("```python\nClient\n```", "not defined"),
        ("```python\nawait nobody\n```", "outside function"),
        ("```console\n$ echo 1\n2\n```", "and not:\n2"),
        ("```console\n$ echo 1\n```", "and not"),
        ("```console\n$ false\n```", "exit code 1"),
        ("```console\n$ true &\nready\n```", "ended"),
        ("```sh\ntrue\nfalse\n```", "exit code 1"),
    ],
)
def test_a_wrong_output_is_an_error(
    tmp_path: Path, isolated: Isolated, block: str, what: str
) -> None:
    path = tmp_path / "lie.md"
    path.write_text(f"Text.\n\n{block}\n")
    with pytest.raises((AssertionError, NameError, SyntaxError)) as caught:
        isolated(run_document, path, tmp_path)
    assert what in str(caught.value)


def test_a_failure_names_its_place(tmp_path: Path, isolated: Isolated) -> None:
    path = tmp_path / "lie.md"
    path.write_text("Text.\n\n```console\n$ true\n$ false\n```\n")
    with pytest.raises(AssertionError) as caught:
        isolated(run_document, path, tmp_path)
    assert caught.value.__notes__ == [f"{path}:5: false"]


@each_case(
    ("pattern", "text", "fits"),
    [
        ("a  b", "a      b", True),
        ("a b", "ab", False),
        ("a...z", "a\nb\nz", True),
        ("...", "", True),
        ("a.c", "abc", False),
        ("a", "a\n", False),
    ],
)
def test_texts_are_compared(pattern: str, text: str, fits: bool) -> None:
    assert matches(pattern, text) is fits


def test_blocks_of_shells_are_split_into_commands() -> None:
    console = [(item.text, item.expected) for item in of_console("$ a \\\n> b\n1\n2\n$ c &\n$ d")]
    assert console == [("a b", "1\n2\n"), ("c &", ""), ("d", "")]
    shell = [(item.text, item.expected, item.line) for item in of_sh("# x\na   # y\n\nb \\\n  c\n")]
    assert shell == [("a", None, 2), ("b   c", None, 4)]


def test_blocks_without_examples_are_not_run(tmp_path: Path) -> None:
    def evaluate(example: Example) -> None:
        raise AssertionError(example)

    examples = Examples(evaluate, evaluate, evaluate, evaluate)
    path = tmp_path / "some.md"
    path.write_text("```\nx\n```\n\n```text\ny\n```\n\n`z.json`:\n\n```json\n{}\n```\n")
    assert len(list(read(path, examples).examples())) == 1
