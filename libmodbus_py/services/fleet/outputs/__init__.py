"""
Outputs: the destinations of readings.

Each output is one file, which imports its libraries when the output is opened, and one row in
`kinds`. The other files are::

    kinds          the table of outputs: their names in fleet files and options
    output         the protocols that outputs implement
    exclusive      things that only one output may use, such as a file
    pump           moves the readings that wait to an output
    refusals       finds the poll on which the other side ends the connection
    influx_server  for influx: a server of InfluxDB, by HTTP
    line_protocol  for influx: readings in the line protocol
    mqtt_messages  for mqtt: messages, and the last values that the broker retains
    topics         for mqtt: topics with names and labels
    poll_messages  messages with the readings of a poll, for mqtt and for workers
    device_states  the devices that answer, as their readings show
    last_values    the last reading of each point, for metrics
    forms          readings as JSON and CSV
    trust          the certificate authorities that are trusted
    secret_file    a password in a file, which is read again
    line_file      lines in a file or on the standard output
    writer_thread  a thread that writes, so that nothing else waits for a disk
"""
