"""Files with passwords, tokens and seeds, which only their owner can read."""

from pathlib import Path


def write_secret(path: Path, text: str) -> Path:
    """Write a file that group and others cannot read; return its path."""
    path.touch(0o600)
    path.chmod(0o600)
    path.write_text(text)
    return path
