"""
Mistakes in arguments and files are the same after they were passed to another process.
"""

from __future__ import annotations

import pickle

from libmodbus_py.protocol.mistakes import WrongType, WrongValue
from tests.support.cases import each_case


@each_case(
    "mistake",
    [
        WrongValue("unit", "must be in 0..255, not 300"),
        WrongValue(path=("route", 3, "to"), reason="must be a URL"),
        WrongType.about(("route", 3), "it is given twice"),
    ],
)
def test_a_mistake_survives_pickling(mistake: WrongValue | WrongType) -> None:
    copy = pickle.loads(pickle.dumps(mistake))
    assert type(copy) is type(mistake)
    assert (str(copy), copy.path, copy.args) == (str(mistake), mistake.path, mistake.args)
