"""
Listens to the traffic between other devices on a line, and pairs it into transactions.

Bytes come from `sources`, `separator` cuts them into frames, `pairing` makes each `transaction`,
and `listener` is the iterator over them; `capture` writes frames to files, and reads them;
`packets` reads any pcap or pcapng file, and `streams` puts Modbus/TCP in it together; `named` has
the cells that masters read and write by name; `replay` makes devices of a capture.
"""
