"""The folder of outside data; what needs them is marked `data` (tests/conftest.py)."""

import os
from pathlib import Path

DATA = Path(os.environ.get("SEATRIAL_DATA") or "SEATRIAL_DATA")
