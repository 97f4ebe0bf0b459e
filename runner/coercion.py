"""Values of a configuration against the types that a dataclass declares.

    bool, int, float (takes integers), str, Path, None, Literal, X | Y, Any
    list[T], Sequence[T], tuple[T, ...], tuple[A, B, C], dict[str, T]
    numpy arrays, from numbers and nested lists
    dataclasses, from nested nodes

Numbers must be finite. A bool is not a number, and text is not turned into one.
"""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from seatrial.models.errors import ConfigurationError

Builder = Callable[[Mapping[str, Any], str, type | None], Any]


def coerce(value: Any, annotation: Any, key: str, *, build: Builder | None = None) -> Any:
    """`value` as the type `annotation`; ConfigurationError, naming `key`, where it is not one.

    `build(node, key, cls)` makes the objects of nested nodes.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigurationError(f"{key}: got {value}, expected a finite number")
    if annotation is Any or annotation is object:
        return build(value, key, None) if build and _is_node(value) else value
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        return _union(value, arguments, key, build)
    if origin is Literal:
        return _literal(value, arguments, key)
    if _is_array(origin or annotation):
        return _array(value, annotation, key)
    kind = origin or annotation
    if kind in (list, Sequence, tuple):
        return _sequence(value, annotation, key, build)
    if kind in (dict, Mapping):
        return _mapping(value, arguments, key, build)
    if kind in _SCALARS:
        return _scalar(value, kind, key, expected(annotation))
    return _object(value, kind, key, build)


def expected(annotation: Any) -> str:
    """What a value of this type is called in an error message."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    kind = origin or annotation
    if origin in (Union, UnionType):
        return " or ".join(expected(part) for part in arguments)
    if origin is Literal:
        return f"one of {', '.join(str(part) for part in arguments)}"
    if kind is tuple and arguments and arguments[-1] is not Ellipsis:
        return f"a list of {len(arguments)}"
    if kind in (list, Sequence, tuple):
        return f"a list ({expected(arguments[0])} each)" if arguments else "a list"
    if kind in (dict, Mapping):
        return "a group of options"
    if _is_array(kind):
        return "a list of numbers"
    return _SCALARS.get(kind, f"a {getattr(kind, '__name__', kind)}")


_SCALARS: dict[Any, str] = {
    bool: "true or false",
    int: "an integer",
    float: "a number",
    str: "text",
    Path: "a path",
    NoneType: "null",
}


def _wrong(value: Any, key: str, wanted: str) -> ConfigurationError:
    if value is None or isinstance(value, bool):
        text = {None: "null", True: "true", False: "false"}[value]  # as YAML writes them
    else:
        text = repr(value)
    text = text if len(text) <= 80 else f"{text[:77]}..."
    return ConfigurationError(f"{key}: got {text}, expected {wanted}")


def _scalar(value: Any, kind: Any, key: str, wanted: str) -> Any:
    if kind is float and type(value) is int and abs(value) <= sys.float_info.max:
        return float(value)
    if kind is Path and isinstance(value, str) and value:
        return Path(value)
    if type(value) is kind:
        return value
    raise _wrong(value, key, wanted)


def _literal(value: Any, choices: tuple[Any, ...], key: str) -> Any:
    for choice in choices:
        if type(value) is type(choice) and value == choice:
            return choice
    raise _wrong(value, key, expected(Literal[choices]))


def _union(value: Any, members: tuple[Any, ...], key: str, build: Builder | None) -> Any:
    """The first member that takes the value; an only member beside null speaks for itself."""
    if value is None and NoneType in members:
        return None
    others = [member for member in members if member is not NoneType]
    if len(others) == 1 and (get_origin(others[0]) or others[0]) not in (*_SCALARS, Literal):
        return coerce(value, others[0], key, build=build)
    for member in others:
        try:
            return coerce(value, member, key, build=build)
        except ConfigurationError:
            if _is_node(value):  # a node says itself what it is, and what is wrong with it
                raise
    raise _wrong(value, key, " or ".join(expected(part) for part in members))


def _sequence(value: Any, annotation: Any, key: str, build: Builder | None) -> Any:
    kind, arguments = get_origin(annotation) or annotation, get_args(annotation)
    if not isinstance(value, list | tuple):
        raise _wrong(value, key, expected(annotation))
    fixed = kind is tuple and arguments and arguments[-1] is not Ellipsis
    if fixed and len(value) != len(arguments):
        raise _wrong(value, key, expected(annotation))
    each = arguments if fixed else [arguments[0] if arguments else Any] * len(value)
    items = [
        coerce(item, part, f"{key}[{i}]", build=build)
        for i, (item, part) in enumerate(zip(value, each, strict=True))
    ]
    return items if kind is list else tuple(items)


def _mapping(
    value: Any, arguments: tuple[Any, ...], key: str, build: Builder | None
) -> dict[Any, Any]:
    if not isinstance(value, Mapping):
        raise _wrong(value, key, "a group of options")
    names, part = arguments or (Any, Any)
    return {
        coerce(name, names, f"{key}.{name}"): coerce(item, part, f"{key}.{name}", build=build)
        for name, item in value.items()
    }


def _object(value: Any, kind: Any, key: str, build: Builder | None) -> Any:
    """An object of a class: built from a nested node, and of the class that is asked for."""
    if build is None or not isinstance(value, Mapping):
        raise _wrong(value, key, expected(kind))
    named = kind if isinstance(kind, type) else None
    made = build(value, key, named if is_dataclass(named) else None)
    nominal = named is not None and not getattr(named, "_is_protocol", False)
    if nominal and not isinstance(made, kind):
        raise ConfigurationError(f"{key}: got a {type(made).__name__}, expected {expected(kind)}")
    return made


def _is_node(value: Any) -> bool:
    return isinstance(value, Mapping) and "_target_" in value


def _is_array(kind: Any) -> bool:
    # An annotation can only be numpy's where numpy is imported already.
    numpy = sys.modules.get("numpy")
    return numpy is not None and kind is numpy.ndarray


def _array(value: Any, annotation: Any, key: str) -> Any:
    import numpy as np

    arguments = get_args(annotation)
    scalar_type = get_args(arguments[1]) if len(arguments) > 1 else ()
    integer = (
        bool(scalar_type)
        and isinstance(scalar_type[0], type)
        and issubclass(scalar_type[0], np.integer)
    )
    if not isinstance(value, list | tuple):
        raise _wrong(value, key, "a list of numbers")
    numbers = _numbers(value, int if integer else float, key)
    try:
        array = np.array(numbers, dtype=np.int64 if integer else np.float64)
    except ValueError:
        raise ConfigurationError(f"{key}: rows of different lengths, expected equal ones") from None
    array.setflags(write=False)
    return array


def _numbers(value: Any, kind: type, key: str) -> Any:
    if isinstance(value, list | tuple):
        return [_numbers(item, kind, f"{key}[{i}]") for i, item in enumerate(value)]
    return coerce(value, kind, key)
