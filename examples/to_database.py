"""
An output of a fleet to a database: each batch of readings in one transaction, here of SQLite.
"""

import asyncio
import sqlite3

from libmodbus_py.fleet import Fleet, Output, load

TABLE = "CREATE TABLE IF NOT EXISTS readings (time, device, name, value)"


class ToDatabase(Output):
    name = "database"

    async def open_output(self):
        self.database = sqlite3.connect("values.db", timeout=1)

    async def write_readings(self, readings):
        rows = [(reading.time, reading.device, reading.name, reading.value) for reading in readings]
        try:
            with self.database:
                self.database.execute(TABLE)
                self.database.executemany("INSERT INTO readings VALUES (?, ?, ?, ?)", rows)
        except sqlite3.OperationalError as error:
            raise OSError(str(error)) from error

    async def close_output(self):
        self.database.close()


async def main():
    await Fleet(load("fleet.toml").devices, outputs=[ToDatabase()]).run(once=True)


asyncio.run(main())
