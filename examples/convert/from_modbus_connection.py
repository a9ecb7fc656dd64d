"""
Yield the rows of a device class of modbus-connection: write(rows(Meter), "meter.csv").
"""

KINDS = {"NumberField": "int", "RawField": "uint", "FloatField": "float", "StringField": "string:"}


def rows(component):
    for name, field in component.declared_fields.items():
        kind, space = type(field).__name__, getattr(field, "space", component.register_space)
        if kind in ("CoilField", "DiscreteInputField"):
            yield name, space, field.address
        elif kind in KINDS:
            unsigned = "" if getattr(field, "signed", True) else "u"
            size = field.count * (2 if kind == "StringField" else 16)
            order = {"little": "CDAB"}.get(getattr(field, "word_order", "big"), "ABCD")
            layout = order, getattr(field, "scale", 1), getattr(field, "offset", 0), field.unit
            type_word, access = f"{unsigned}{KINDS[kind]}{size}", "rw" if field.writable else "r"
            yield name, space, field.address, type_word, *layout, access
