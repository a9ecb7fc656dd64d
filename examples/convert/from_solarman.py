"""
Make inverter.csv of an inverter.yaml of Solarman.
"""

from write_map import load, write

TYPES = {1: "uint16", 2: "int16", 3: "uint32", 4: "int32"}


def rows(content):
    for each in (each for group in content["parameters"] for each in group["items"]):
        registers, scale = each["registers"], each.get("scale", 1)
        if each["rule"] not in TYPES or len(registers) > 2:
            print("left out:", each["name"])
            continue
        order = "CDAB" if registers[0] < registers[-1] else "ABCD"
        states = "; ".join(f"{state['key']} = {state['value']}" for state in each.get("lookup", []))
        scaling = ("", "") if states else (scale, -each.get("offset", 0) * scale)
        layout = TYPES[each["rule"]], order, *scaling, each.get("uom")
        yield each["name"], "holding", min(registers), *layout, "", states


write(rows(load("inverter.yaml")), "inverter.csv")
