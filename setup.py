import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

EXAMPLES = "examples"


class BuildPy(build_py):
    """Gives what is built the examples, which a checkout has beside the package."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            into = Path(self.build_lib, "libmodbus_py", "tools", "simulator", EXAMPLES)
            shutil.copytree(EXAMPLES, into, dirs_exist_ok=True)


setup(
    cmdclass={"build_py": BuildPy},
    cffi_modules=["build_ffi.py:ffi", "build_ffi.py:scan"],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
