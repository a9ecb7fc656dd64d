"""The commands that tests.packaging.roots tries in new systems, and where it can."""

import os
import shutil
import subprocess

import pytest

from tests.packaging import roots


@pytest.mark.parametrize("way", roots.WAYS)
def test_each_way_to_install_is_one_block_that_ends_with_the_demonstration(way: str) -> None:
    *commands, last = roots.block(way).splitlines()
    assert len(commands) in (2, 3)
    assert last.endswith("libmodbus-py demo")
    # A new machine has no list of packages; ./run fetches it.
    assert commands[0] == "./run wheel" or commands[0].startswith("sudo apt update && sudo apt")


@pytest.mark.parametrize(
    ("user", "program", "error", "reason"),
    [
        (1000, "/bin/x", "", "only root can make a system to try it in"),
        (0, None, "", "not installed: debootstrap, unshare, chroot, ip, tar"),
        (0, "/bin/x", "unshare: unshare failed\n", "unshare: unshare failed"),
        (0, "/bin/x", "", ""),
    ],
)
def test_a_missing_test_system_is_named_as_the_reason(user, program, error, reason, monkeypatch):
    process = subprocess.CompletedProcess([], bool(error), "", error)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: process)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(shutil, "which", lambda name: program)
    assert roots.why_not() == reason


def test_the_quick_tests_run_in_each_debian_with_another_python() -> None:
    others = [release for release in roots.PYTHONS if roots.is_other(release)]
    assert len(others) >= len(roots.PYTHONS) - 1
    assert roots.commands("quick").startswith("./run test --quick ")
    assert "-k 'quick and other'" in (roots.ROOT / ".ci" / "run").read_text()


def test_changed_commands_are_downloaded_again(tmp_path, monkeypatch) -> None:
    """A block with other commands than those whose downloads are kept runs with the network."""
    monkeypatch.setattr(roots, "CACHE", tmp_path)
    before = roots.Needs("trixie", "source").stamp
    assert roots.Needs("trixie", "source").stamp == before
    other = roots.block("source") + "true\n"
    monkeypatch.setattr(roots, "block", lambda way: other)
    assert roots.Needs("trixie", "source").stamp != before
