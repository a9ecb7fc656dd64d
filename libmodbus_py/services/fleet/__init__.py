"""
Polls many devices, each at its interval, and gives what is read to outputs.

From the file to the wire, and back::

    files          fleet files in TOML
      devices_csv  ... and devices in CSV, for thousands
    config         what they hold: DeviceConfig; as JSON, too
    fleet          who is polled, and who is told; Fleet
      schedule     when; no clock
      line         one connection: whose poll is next
        poller     ... one device: what is asked next, what came of it
    readings       what was read, and which of it is told; Reading
    buffer         readings that wait for an output, the oldest of which are dropped
    outputs        where they go, a folder of its own
    commands       writes by name that come over an output
    statistics     what happened, counted
    trial          who answers, and what lines can carry, before anything is polled
"""
