"""``python -m libmodbus_py``: the command line."""

import sys

from .cli.main import main

sys.exit(main())
