"""Sea trials for models and controllers of marine vessels.

In a checkout `models`, `runner` and `conf` stand beside this folder; installed, they are inside it.
"""

from pathlib import Path

_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "pyproject.toml").is_file():
    __path__.append(str(_checkout))
