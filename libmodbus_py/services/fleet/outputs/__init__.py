"""
Outputs: the destinations of readings. Each is one file, and imports its libraries when opened.

::

    kinds          the names of outputs in fleet files and options
    json_output    a line of JSON for each reading
    csv_output     a row of CSV for each reading
    exclusive      things that only one output may use, such as a file
    device_states  the devices that answer, as their readings show
    influx         the line protocol of InfluxDB, to a file or a server
    influx_server  ... the server, by HTTP
    line_protocol  ... the lines
    mqtt           a topic for each value or device, retained; writes to named points
    mqtt_messages  ... the messages, and the last values that the broker retains
    topics         ... the topics, with names and labels
    nats           a message for each poll, kept in a stream, from one machine
    stream         ... the stream, also used by workers on several machines
    poll_messages  messages with the readings of a device, for NATS and MQTT
    subjects       the subjects of messages
    last_values    the last reading of each point, for metrics
    forms          readings as JSON and CSV
    labels         the labels of devices, as an output needs them
    trust          the certificate authorities that are trusted
    secret_file    a password in a file, which is read again
    text_file      a file or the standard output
    rotation       ... when the file is renamed, and how many old ones are kept
    writer_thread  a thread that writes, so that nothing else waits for a disk
    pump           moves the readings that wait to an output
    refusals       the poll on which the other side ends the connection
    output         the protocols that outputs implement
"""
