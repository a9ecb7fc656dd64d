"""
Serial lines with the driver of a real UART: `./run uart`, before a release and each night.

`__main__` starts Debian's kernel in QEMU, with the wheel and its Python in memory, and is the cable
between three 16550A; `guest` is what runs there: masters and slaves of this package and libmodbus.
"""
