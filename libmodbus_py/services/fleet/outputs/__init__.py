"""
Where readings go. Each is one file, and imports what it needs when it is used.

::

    kinds          what files and options call them
    json_output    a line of JSON for each reading
    csv_output     a row of CSV for each reading
    mqtt           a topic for each value, retained; writes by name
    nats           a message for each poll, in a stream that keeps them
    stream         that stream; of workers on several machines, too
    subjects       what its messages are about
    last_values    the last value of each, for metrics
    forms          what readings look like as text
    text_file      a file or the standard output
    writer_thread  a thread that writes, so that nothing else waits for a disk
    pump           moves readings from a buffer to an output
    output         the face that all have
"""
