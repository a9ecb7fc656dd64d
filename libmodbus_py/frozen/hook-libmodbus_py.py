"""
The modules that PyInstaller cannot see, because they are imported when they are first used; and
the stubs that list them.
"""

from PyInstaller.utils.hooks import collect_data_files, collect_submodules

datas: list[tuple[str, str]] = collect_data_files(
    "libmodbus_py", includes=["**/*.pyi", "**/page/*", "**/scripts/*"]
)
hiddenimports: list[str] = collect_submodules(
    "libmodbus_py", filter=lambda name: ".integrations" not in name
)
hiddenimports += ["_cffi_backend"]
