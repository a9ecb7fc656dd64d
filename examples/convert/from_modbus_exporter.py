"""
Make em111.csv of the first module in a modbus.yml of modbus_exporter.
"""

from write_map import load, write

TABLES = {"1": "coils", "2": "discrete", "3": "holding", "4": "input"}
ORDERS = {"big": "ABCD", "little": "DCBA", "mixed": "BADC", "yolo": "CDAB"}


def rows(module):
    for each in module["metrics"]:
        code, address = str(each["address"])[0], int(str(each["address"])[1:])
        name = "_".join([each["name"], *map(str, each.get("labels", {}).values())])
        type = each["dataType"].replace("bool", "")
        bit = each.get("bitOffset") if code in "34" else ""
        layout = type, ORDERS[each.get("endianness", "big")], each.get("factor")
        yield name, TABLES[code], address, *layout, "", "", "r", "", bit


write(rows(load("modbus.yml")["modules"][0]), "em111.csv")
