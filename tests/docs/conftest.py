"""What tests of documents have: a process with a network and a /dev of its own."""

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import pytest

from tests.docs.namespace import isolate

Isolated = Callable[..., Any]


@pytest.fixture(scope="session")
def isolated() -> Iterator[Isolated]:
    """Call a function in that process, which is the same for all tests; raise what it raises."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        try:
            process.submit(isolate).result()
        except PermissionError as error:
            pytest.skip(f"this system allows no namespaces: {error}")
        yield lambda function, *arguments: process.submit(function, *arguments).result()
