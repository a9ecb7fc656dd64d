"""
Make em111.csv of the first module in a modbus.yml of modbus_exporter.
"""

from write_map import load, write

TABLES = {"1": "coils", "2": "discrete", "3": "holding", "4": "input"}
ORDERS = {"big": "ABCD", "little": "DCBA", "mixed": "BADC", "yolo": "CDAB"}


def rows(module):
    for row in module["metrics"]:
        code, address = str(row["address"])[0], int(str(row["address"])[1:])
        name = "_".join([row["name"], *map(str, row.get("labels", {}).values())])
        type = row["dataType"].replace("bool", "")
        bit = row.get("bitOffset") if code in "34" else ""
        layout = type, ORDERS[row.get("endianness", "big")], row.get("factor")
        yield name, TABLES[code], address, *layout, "", "", "r", "", bit


write(rows(load("modbus.yml")["modules"][0]), "em111.csv")
