"""
Make boiler.csv of the first hub in a configuration.yaml of Home Assistant.
"""

from write_map import load, write

ORDERS = {None: "ABCD", "word": "CDAB", "byte": "BADC", "word_byte": "DCBA"}
USUAL = {"sensors": "holding", "binary_sensors": "coil", "switches": "holding"}


def rows(hub):
    for kind, usual in USUAL.items():
        for row in hub.get(kind, []):
            table = row.get("input_type") or row.get("write_type") or usual
            type = row.get("data_type", "int16") if kind == "sensors" else ""
            type = f"string:{2 * row['count']}" if type == "string" else type
            layout = type, ORDERS[row.get("swap")], row.get("scale"), row.get("offset")
            yield row["name"], table, row["address"], *layout, row.get("unit_of_measurement")


write(rows(load("configuration.yaml")["modbus"][0]), "boiler.csv")
