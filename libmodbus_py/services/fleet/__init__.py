"""
Polls many devices, each at its interval, and writes the readings to outputs.

From the fleet file to the wire, and back::

    files          fleet files in TOML, with devices in CSV for thousands
    config         the options of a device: DeviceConfig; also as JSON; and the table [engine]
    fleet          polls devices and passes readings to outputs: Fleet
      poller       one device: its polls and its state; and the connection that devices share
      receivers    passes readings to the journal, to outputs, and to iterators
    readings       values of devices, the choice of those that are reported, and those that wait
    journal        readings on the disk, a folder of its own
    outputs        the destinations of readings, a folder of its own
    rewriting      values that are written again every so many seconds
    commands       writes to named points that are received over an output
    statistics     counters of a fleet, its outputs and its journal
    shown_fleet    values and devices as the live page shows them, and lines on a terminal
    trial          checks before polling: the devices that answer, and overloaded serial lines
"""
