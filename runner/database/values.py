"""What a database can hold: numbers without NaN, text without NUL, JSON without either."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def number(value: Any) -> float | None:
    """`value` as a float; NaN and None as None (NULL)."""
    if value is None:
        return None
    as_float = float(value)
    return None if math.isnan(as_float) else as_float


def integer(value: Any) -> int | None:
    """`value` as an int of Python's own; None as None."""
    return None if value is None else int(value)


def text(value: str) -> str:
    """`value` without what PostgreSQL refuses in text: NUL and halves of surrogate pairs."""
    return value.replace("\x00", "\\x00").encode("utf-8", "backslashreplace").decode("utf-8")


def plain(value: Any) -> Any:
    """`value` as what JSON knows; NaN becomes null, an infinite number the text "inf" or "-inf"."""
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return text(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else str(value)
    if isinstance(value, Mapping):
        return {text(str(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return text(str(value))
