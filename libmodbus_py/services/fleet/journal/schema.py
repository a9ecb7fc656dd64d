"""
The tables of a journal.

::

    device (id, name, labels)               labels in JSON; a row for each set of labels
    point  (id, points, device, name, unit) `points` is the id of the first point of its list
    poll   (id, readings, time, device, points, chosen, data, trouble)       see `polls.Row`
    place  (output, confirmed)              the last reading that each output has confirmed
    run    (first, unused)                  see `numbers.Unused`
    reading                                 a view: one row for each reading

The newest list of points of a device has all points that the device ever had. A poll refers to
positions in this list; only a poll with another point begins a new list. So polls of some points,
such as those that have changed, add no lists, also after a failed transaction or in the next run.
"""

from __future__ import annotations

__all__ = ["APPLICATION", "SCHEMA", "VERSION"]

# In the header of the file; `file` and other programs name the kind of a database by it.
APPLICATION = 0x4D424A31
VERSION = 1

SCHEMA = """
CREATE TABLE device (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    labels TEXT NOT NULL DEFAULT '{}',
    UNIQUE (name, labels)
);
CREATE TABLE point (
    id INTEGER PRIMARY KEY,
    points INTEGER NOT NULL,
    device INTEGER NOT NULL REFERENCES device,
    name TEXT NOT NULL,
    unit TEXT NOT NULL
);
CREATE INDEX point_of_device ON point (device, points);
CREATE TABLE poll (
    id INTEGER PRIMARY KEY,
    readings INTEGER NOT NULL,
    time REAL NOT NULL,
    device INTEGER NOT NULL REFERENCES device,
    points INTEGER NOT NULL REFERENCES point,
    chosen TEXT,
    data TEXT NOT NULL,
    trouble TEXT
);
CREATE INDEX poll_of_device ON poll (device, time);
CREATE TABLE place (
    output TEXT PRIMARY KEY,
    confirmed INTEGER NOT NULL
) WITHOUT ROWID;
CREATE TABLE run (
    first INTEGER PRIMARY KEY,
    unused INTEGER NOT NULL
);
CREATE VIEW reading AS
SELECT poll.id + value.key AS id,
       strftime('%Y-%m-%dT%H:%M:%fZ', poll.time, 'unixepoch') AS time,
       device.name AS device,
       point.name AS name,
       value.value AS value,
       point.unit AS unit,
       coalesce(json_extract(poll.trouble, '$."' || value.key || '"[0]'), 'good') AS quality,
       coalesce(json_extract(poll.trouble, '$."' || value.key || '"[1]'), '') AS reason,
       device.labels AS labels,
       poll.time AS seconds
  FROM device
  JOIN poll ON poll.device = device.id
  JOIN json_each(poll.data) AS value
  JOIN point ON point.id = poll.points
       + coalesce(json_extract(poll.chosen, '$[' || value.key || ']'), value.key);
"""
