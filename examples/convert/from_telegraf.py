"""
Make telegraf.csv of the first device in a telegraf.conf.
"""

import tomllib

from write_map import write


def rows(device):
    for table in ("coils", "discrete_inputs", "holding_registers", "input_registers"):
        for row in device.get(table, []):
            bits, type = 16 * len(row["address"]), row.get("data_type", "")
            fixed = {"FIXED": f"int{bits}", "UFIXED": f"uint{bits}", "FLOAT32": f"uint{bits}"}
            type = fixed.get(type, type.removesuffix("-IEEE"))
            layout = type, row.get("byte_order"), row.get("scale")
            yield row["name"], table, row["address"][0], *layout


with open("telegraf.conf", "rb") as file:
    write(rows(tomllib.load(file)["inputs"]["modbus"][0]), "telegraf.csv")
