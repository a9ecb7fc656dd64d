"""
Read YAML, and write a register map in CSV: what the converters beside this file share.
"""

import csv

HEADINGS = (
    *("name", "table", "address", "type", "order", "scale", "offset", "units", "access", "states"),
    "bit",
)


def load(path):
    import yaml

    with open(path, encoding="utf-8") as file:
        return yaml.safe_load(file)


def write(rows, path):
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([HEADINGS, *rows])
