from setuptools import setup

setup(
    cffi_modules=["build_ffi.py:ffi", "build_ffi.py:scan"],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
