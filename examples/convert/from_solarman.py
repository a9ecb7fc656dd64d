"""
Make inverter.csv of an inverter.yaml of Solarman.
"""

from write_map import load, write

TYPES = {1: "uint16", 2: "int16", 3: "uint32", 4: "int32"}


def rows(content):
    for row in (entry for group in content["parameters"] for entry in group["items"]):
        registers, scale = row["registers"], row.get("scale", 1)
        if row["rule"] not in TYPES or len(registers) > 2:
            print("left out:", row["name"])
            continue
        order = "CDAB" if registers[0] < registers[-1] else "ABCD"
        states = "; ".join(f"{state['key']} = {state['value']}" for state in row.get("lookup", []))
        scaling = ("", "") if states else (scale, -row.get("offset", 0) * scale)
        layout = TYPES[row["rule"]], order, *scaling, row.get("uom")
        yield row["name"], "holding", min(registers), *layout, "", states


write(rows(load("inverter.yaml")), "inverter.csv")
