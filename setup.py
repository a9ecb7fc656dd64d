import os
import runpy
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from setuptools import setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py

EXAMPLES = "examples"

# What the C compiler must find -> the Debian package that has it.
NEEDED = {
    "#include <stdio.h>": "gcc libc6-dev",
    "#include <Python.h>": "python3-dev",
    "#include <modbus/modbus.h>": "libmodbus-dev",
}

MAN = "build/shared/libmodbus-py.1"

# Where shells and man look below the prefix of an installation -> what they find there.
SHARED = {
    "share/man/man1": [MAN],
    "share/bash-completion/completions": ["packaging/shared/libmodbus-py"],
    "share/zsh/site-functions": ["packaging/shared/_libmodbus-py"],
}


class BuildPy(build_py):
    """Gives what is built the examples, which a checkout has beside the package."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            into = Path(self.build_lib, "libmodbus_py", "tools", "simulator", EXAMPLES)
            shutil.copytree(
                EXAMPLES, into, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__")
            )


class BuildExt(build_ext):
    """Says in one line what is missing, in place of the errors of a compiler; makes the manual."""

    def run(self) -> None:
        super().run()
        if not (self.inplace or self.editable_mode):
            write_manual(self.build_lib)

    def build_extensions(self) -> None:
        missing = [package for line, package in NEEDED.items() if not self._compiles(line)]
        if missing:
            raise SystemExit(
                "libmodbus-py is compiled against libmodbus of the system; install what is missing:"
                f" sudo apt install {' '.join(missing)}"
            )
        super().build_extensions()

    def _compiles(self, line: str) -> bool:
        folders = [f"-I{folder}" for folder in [*self.include_dirs, *self.compiler.include_dirs]]
        command = [*self.compiler.compiler_so, *folders, "-fsyntax-only", "-x", "c", "-"]
        try:
            done = subprocess.run(command, input=f"{line}\n", text=True, capture_output=True)
        except OSError:  # there is no such compiler
            return False
        return done.returncode == 0


def write_manual(package: str) -> None:
    """Write the manual page from the help of what was built."""
    Path(MAN).parent.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([package, *sys.path]),
        "PYTHONDONTWRITEBYTECODE": "1",  # all that lies in this folder is packed
    }
    subprocess.run([sys.executable, "packaging/man.py", MAN], env=environment, check=True)


def readme() -> str:
    """Return the first page for an index, which has no files beside it."""
    links = runpy.run_path("packaging/docs/links.py")
    root = Path.cwd()
    text = Path("README.md").read_text(encoding="utf-8")
    address = links["repository"](root)
    return str(links["absolute"](text, "", root, address)) if address else text


def tags() -> dict[str, dict[str, str]]:
    """Return the options of wheels: one for all Pythons, where Python has a limited API."""
    if sysconfig.get_config_var("Py_GIL_DISABLED"):
        return {}
    return {"bdist_wheel": {"py_limited_api": "cp311"}}


if __name__ == "__main__":
    setup(
        cmdclass={"build_py": BuildPy, "build_ext": BuildExt},
        cffi_modules=["build_ffi.py:ffi", "build_ffi.py:scan"],
        long_description=readme(),
        long_description_content_type="text/markdown",
        data_files=list(SHARED.items()),
        options=tags(),
    )
