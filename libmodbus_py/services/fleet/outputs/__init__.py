"""
Outputs: the destinations of readings.

Each output imports its libraries when it is opened, and has one row in `kinds`::

    kinds            the table of outputs: their names in fleet files and options
    output           the protocols that outputs implement
    exclusive        things that only one output may use, such as a file
    pump             moves the readings that wait to an output
    refusals         finds the poll on which the other side ends the connection
    line_file        lines in a file or on the standard output
    file_outputs     JsonOutput and CsvOutput
    forms            readings as JSON and CSV
    influx           Influx: the line protocol in a file, or sent to a server by HTTP
    line_protocol    readings in the line protocol
    mqtt             Mqtt: the output
    mqtt_connection  its connection to a broker
    mqtt_commands    commands that the broker passes on
    mqtt_messages    messages, and what the broker retains of them
    topics           topics with names and labels
    poll_messages    messages with the readings of a poll, for mqtt and for workers
    last_values      the last reading of each point, for metrics
    credentials      passwords and certificate authorities in files, which are read again
    writer_thread    a thread that writes, so that nothing else waits for a disk
"""
