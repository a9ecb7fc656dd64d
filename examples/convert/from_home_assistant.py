"""
Make boiler.csv of the first hub in a configuration.yaml of Home Assistant.
"""

from write_map import load, write

ORDERS = {None: "ABCD", "word": "CDAB", "byte": "BADC", "word_byte": "DCBA"}
USUAL = {"sensors": "holding", "binary_sensors": "coil", "switches": "holding"}


def rows(hub):
    for kind, usual in USUAL.items():
        for each in hub.get(kind, []):
            table = each.get("input_type") or each.get("write_type") or usual
            type = each.get("data_type", "int16") if kind == "sensors" else ""
            type = f"string:{2 * each['count']}" if type == "string" else type
            layout = type, ORDERS[each.get("swap")], each.get("scale"), each.get("offset")
            yield each["name"], table, each["address"], *layout, each.get("unit_of_measurement")


write(rows(load("configuration.yaml")["modbus"][0]), "boiler.csv")
