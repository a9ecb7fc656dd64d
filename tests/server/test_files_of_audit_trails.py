"""
Files to which an audit trail must not be written, and such as must hold up nobody.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest

from libmodbus_py.server.audit import AuditEvent, AuditFile
from tests.support.cases import each_case

EVENT = AuditEvent(datetime(2026, 1, 1, tzinfo=UTC), "write", "192.0.2.1:1", "ok")


@each_case("text", ["[[device]]\n", "-----BEGIN PRIVATE KEY-----\n", "\0\0", "time,device\n"])
def test_another_file_is_not_appended_to(tmp_path: Path, text: str) -> None:
    path = tmp_path / "file"
    path.write_text(text)
    with pytest.raises(ValueError, match="is not an audit trail"):
        AuditFile(path)
    assert path.read_text() == text


@each_case("text", ["", '{"event": "write"}\n', '{"event": "wri', '\n{"event": "write"}\n'])
def test_an_audit_trail_goes_on(tmp_path: Path, text: str) -> None:
    path = tmp_path / "audit.jsonl"
    path.write_text(text)
    file = AuditFile(path)
    file(EVENT)
    file.close()
    assert path.read_text() == f"{text}{EVENT.json()}\n"


def test_a_named_pipe_without_a_reader_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with pytest.raises(OSError, match="No such device"):
        AuditFile(path)


def fill(file: AuditFile) -> None:
    for _ in range(10_000):
        file(EVENT)


def test_a_named_pipe_holds_up_nobody(tmp_path: Path) -> None:
    """Its reader is slow, and then gone, also when the file is opened again."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    file = AuditFile(path)
    file(EVENT)
    assert os.read(reader, 1000) == EVENT.json().encode() + b"\n"
    with pytest.raises(BlockingIOError):
        fill(file)
    os.close(reader)
    with pytest.raises(BrokenPipeError):
        file(EVENT)
    with pytest.raises(OSError, match="No such device"):
        file.reopen()
    file.close()
