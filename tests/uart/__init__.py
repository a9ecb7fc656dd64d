"""
Serial lines with the driver of a real UART: `./run uart`, before a release and each night.

`__main__` starts Debian's kernel in two virtual machines, and is the cable between their 16550A;
`guest` is what runs there: masters and slaves of this package, as a wheel has it, and libmodbus.
"""
