"""
Outputs: the destinations of readings.

Each output imports its libraries when it is opened, and has one row in `kinds`::

    output           the protocols of outputs, and things that only one may use
    kinds            the kinds of outputs by name
    writer           moves the readings that wait to an output; finds the poll that is refused
    line_file        JsonOutput and CsvOutput, and lines in a file or on the standard output
    forms            readings as JSON and CSV, and messages with the readings of a poll
    influx           Influx: the line protocol in a file, or sent to a server by HTTP
    mqtt             Mqtt: messages, what the broker retains of them, and commands that it passes on
    mqtt_connection  its connection to a broker
    topics           levels of topics and subjects, and topics with names and labels
"""
