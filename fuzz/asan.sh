#!/bin/sh
# fuzz/asan.sh [pytest arguments], after ./run test
# The tests that cross the boundary to C, with the C module built with AddressSanitizer and
# UndefinedBehaviorSanitizer, in a copy: the normal build stays as it is.
set -eu
cd "$(dirname "$0")/.."
python=$PWD/.venv/bin/python
copy=build/asan

rm -rf $copy
mkdir -p $copy
cp -r libmodbus_py tests fuzz build_ffi.py setup.py pyproject.toml README.md LICENSE $copy
rm -f $copy/libmodbus_py/*/_*.*so
cd $copy

flags="-g -O1 -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=all"
CFLAGS=$flags LDFLAGS=$flags "$python" setup.py -q build_ext --inplace

# Leaks are not looked for: an interpreter ends without freeing what it has.
# Python's own allocator would hide what lies beside a bytes object; memory cannot be
# measured under this one.
export ASAN_OPTIONS="detect_leaks=0:log_path=$PWD/report"
export UBSAN_OPTIONS="print_stacktrace=1:log_path=$PWD/report"
export PYTHONMALLOC=malloc
LD_PRELOAD=$(gcc -print-file-name=libasan.so)
export LD_PRELOAD

"$python" - <<'END'
from libmodbus_py.binding import _libmodbus
from libmodbus_py.protocol import _scan
maps = open("/proc/self/maps").read()
assert "libasan" in maps
assert "build/asan" in _libmodbus.__file__ and "build/asan" in _scan.__file__, _scan.__file__
print("asan:", _libmodbus.__file__)
END

result=0
[ $# -gt 0 ] || set -- tests/protocol/test_framing.py tests/protocol/test_rtu_framing.py \
    tests/protocol/test_ascii_framing.py tests/device/test_device.py tests/device/test_model.py tests/device/test_mapping.py \
    tests/server/test_framed.py tests/server/test_server.py tests/server/test_hostile_clients.py \
    tests/server/test_chunks.py tests/server/test_chunks_with_hooks.py \
    tests/client/test_functions.py tests/client/test_bad_answers.py \
    tests/test_fuzz.py tests/interop/test_interop_libmodbus.py
"$python" -m pytest -n 2 -q -p no:cacheprovider --timeout=180 \
    -k "not takes_memory_only" "$@" || result=$?
for report in report.*; do
    [ -e "$report" ] || continue
    result=1
    cat "$report"
done
exit $result
