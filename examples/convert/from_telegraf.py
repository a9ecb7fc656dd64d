"""
Make telegraf.csv of the first device in a telegraf.conf.
"""

import tomllib

from write_map import write


def rows(device):
    for table in ("coils", "discrete_inputs", "holding_registers", "input_registers"):
        for each in device.get(table, []):
            bits, type = 16 * len(each["address"]), each.get("data_type", "")
            fixed = {"FIXED": f"int{bits}", "UFIXED": f"uint{bits}", "FLOAT32": f"uint{bits}"}
            type = fixed.get(type, type.removesuffix("-IEEE"))
            layout = type, each.get("byte_order"), each.get("scale")
            yield each["name"], table, each["address"][0], *layout


with open("telegraf.conf", "rb") as file:
    write(rows(tomllib.load(file)["inputs"]["modbus"][0]), "telegraf.csv")
