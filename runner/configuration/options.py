"""Checks of options against the dataclasses that declare them, by pydantic.

    bool, int, float (takes integers), str, Path, None, Literal, X | Y, Any
    list[T], tuple[T, ...], tuple[A, B, C], dict[str, T]
    other classes, from nested nodes: of the class that `_target_` names, else of the field's own

Numbers must be finite and in their declared ranges (seatrial.models.ranges). Booleans and text are
not converted to numbers. This module is imported when the first trial is built, because pydantic
takes as long to import as Hydra.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, partial
from importlib import import_module
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt
from pydantic import (
    BeforeValidator,
    ConfigDict,
    PlainValidator,
    Strict,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
)
from pydantic_core import ErrorDetails
from typing_extensions import TypedDict

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import Bound, in_words
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.configuration.plugins import failure, is_own, leaves

TUNE = "tune"  # the option that maps others of the same class to the values to choose among
CLASS = "class"  # in a JSON schema: the class that the node must describe
BOUNDS: dict[str, Callable[[Any], Bound]] = {
    "greater_than": Gt, "greater_than_equal": Ge, "less_than_equal": Le, "less_than": Lt,
}  # fmt: skip
EXPECTED = {
    "bool_type": "true or false", "dict_type": "a group of options", "list_type": "a list",
    "finite_number": "a finite number", "float_type": "a number", "int_type": "an integer",
    "none_required": "null", "path_type": "a path", "string_type": "text",
    "too_short": "a longer list", "tuple_type": "a list",
}  # fmt: skip


class OptionError(ValueError):
    """An invalid object: the place inside it, such as `.kp[1]`, and what is wrong there.

    pydantic passes ValueErrors on.
    """

    def at(self, key: str) -> str:
        """Return the message for the object at the option `key`."""
        text = (key + str(self)).lstrip(".: ")
        return re.sub(r"^([^:]+): (?=\1[.:])", "", text)  # where the class names the option itself


class WrongClassError(OptionError):
    """A node that describes an object of another class."""


def part(cls: type, node: object) -> object:
    """Build the object, a `cls`, that a node describes; raises OptionError."""
    if cls is object and node in (None, {}):
        return None
    if not isinstance(node, Mapping):
        raise OptionError(f": got {_shown(node)}, expected a group of options")
    if "_target_" not in node and not is_dataclass(cls):
        raise OptionError("._target_ is missing, expected the name of a class")
    node_class = target(node["_target_"]) if "_target_" in node else cls
    if not (getattr(cls, "_is_protocol", False) or issubclass(node_class, cls)):
        raise WrongClassError(f": got {node_class.__name__}, expected {cls.__name__}")
    values = {name: value for name, value in node.items() if name != "_target_"}
    try:
        return node_class(**options(node_class).validate_python(values))
    except ValidationError as error:
        raise _option_error(error, values, node_class) from None
    except ConfigurationError as error:
        raise OptionError(f": {error}") from error
    except Exception as error:
        if is_own(node_class.__module__):
            raise
        name = f"{node_class.__module__}.{node_class.__name__}"
        raise OptionError(f": {failure(name, error)}") from error


def target(name: object) -> type:
    """Import the dataclass that a `_target_` names; raises OptionError."""
    module_name, _, class_name = name.rpartition(".") if isinstance(name, str) else ("", "", "")
    if not all(part.isidentifier() for part in f"{module_name}.{class_name}".split(".")):
        raise OptionError(f"._target_: got {name!r}, expected the name of a class")
    try:
        result = getattr(import_module(module_name), class_name, None)
    except (Exception, SystemExit) as error:
        absent = error.name if isinstance(error, ModuleNotFoundError) else None
        if absent is None or not f"{module_name}.".startswith(f"{absent}."):
            if is_own(module_name):
                raise  # the module exists, but one of its imports does not: a bug
            raise OptionError(f"._target_: cannot import {failure(str(name), error)}") from error
        result = None
    if not (isinstance(result, type) and is_dataclass(result)):
        raise OptionError(f"._target_: got {name!r}, which is not a dataclass to build")
    return result


@cache
def options(cls: type) -> TypeAdapter[dict[str, object]]:
    """Return pydantic's checks of a dataclass's options; those with a default are optional."""
    hints = get_type_hints(cls, include_extras=True)
    declared = {}
    for field in fields(cls):
        required = field.default is MISSING and field.default_factory is MISSING
        hint = _strict(hints[field.name])
        if field.init:
            declared[field.name] = hint if required else NotRequired[hint]
    if TUNE in declared:
        several: Any = tuple  # of the values of each of the other options
        tuned = {
            name: NotRequired[several[_strict(hints[name]), ...]] for name in {*declared} - {TUNE}
        }
        declared[TUNE] = Union[_table(TUNE, tuned), None]  # noqa: UP007 - known at run time only
    return TypeAdapter(_table(cls.__name__, declared))


def _table(name: str, declared: Mapping[str, Any]) -> Any:
    """A mapping of these keys and no others."""
    make: Any = TypedDict  # its name and keys are known at run time only
    table = make(name, declared)
    table.__pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)
    return table


def _strict(hint: Any) -> Any:
    """Return a type that accepts numbers for numbers only, and builds objects from nodes."""
    kind, arguments = get_origin(hint), get_args(hint)
    if hint in (bool, int, float):
        return Annotated[hint, Strict()]
    if hint in (None, NoneType):
        return Annotated[None, "null"]  # listed in messages like other alternatives
    if hint is Path:
        return Annotated[Path, BeforeValidator(_not_empty)]
    if hint is Any:
        return Annotated[Any, PlainValidator(_anything)]
    if kind is Annotated:
        return Annotated[(_strict(arguments[0]), *arguments[1:])]
    if kind in (Union, UnionType):
        return Union[tuple(map(_strict, arguments))]  # noqa: UP007 - known at run time only
    if arguments and kind is not Literal:
        return kind[tuple(item if item is Ellipsis else _strict(item) for item in arguments)]
    if isinstance(hint, type) and hint not in (str, list, tuple, dict):
        known = WithJsonSchema({CLASS: f"{hint.__module__}.{hint.__qualname__}"})
        return Annotated[Any, PlainValidator(partial(part, hint)), known]
    return hint


def _not_empty(value: object) -> object:
    if value == "":
        raise OptionError(": got '', expected a path")
    return value


def _anything(value: object) -> object:
    for key, leaf in leaves(value):
        if isinstance(leaf, float) and not isfinite(leaf):
            dot = "." if key and key[0] != "[" else ""
            raise OptionError(f"{dot}{key}: got {leaf}, expected a finite number")
    return part(object, value) if isinstance(value, Mapping) and "_target_" in value else value


def _option_error(error: ValidationError, values: Mapping[str, object], cls: type) -> OptionError:
    """Convert the first of pydantic's errors about an object to a message."""
    order = {"extra_forbidden": 0, "missing": 1}
    problems = error.errors(include_url=False)
    problems.sort(key=lambda item: order.get(item["type"], len(order)))
    # Each alternative of a union has its error; the one deepest in the object is reported.
    errors = [item for item in problems if item["loc"][0] == problems[0]["loc"][0]]
    place = max((_place(values, item["loc"]) for item in errors), key=len)
    errors = [item for item in errors if _place(values, item["loc"]) == place]
    at = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place)
    own = [item["ctx"]["error"] for item in errors if "error" in item.get("ctx", {})]
    own.sort(key=lambda each: isinstance(each, WrongClassError))
    if own and isinstance(own[0], OptionError):
        return OptionError(f"{at}{own[0]}")
    first = errors[0]
    got = _shown(first["input"])
    if first["type"] == "extra_forbidden":
        known = [each.name for each in fields(cls) if each.init and each.name != place[-1]]
        expected = f"expected one of {', '.join(known)}" if known else "expected no options here"
        hint = meant(str(place[-1]), known, 3).rstrip() or expected
        return OptionError(f"{at}: unknown option, {hint}")
    if first["type"] == "missing" and not place:
        return OptionError(f".{first['loc'][0]} is missing")
    if first["type"] in BOUNDS:
        bound = BOUNDS[first["type"]](*first["ctx"].values())
        null = " or null" if "none_required" in [item["type"] for item in errors] else ""
        return OptionError(f"{at} must {in_words(bound)}{null}, got {got}")
    expected = " or ".join(dict.fromkeys(map(_expected, errors)))
    if first["type"] == "missing":  # one error per missing number of a list of fixed length
        expected = f"a list of {int(errors[-1]['loc'][-1]) + 1}"
    return OptionError(f"{at}: got {got}, expected {expected}")


def _place(value: Any, location: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Return a location of pydantic without the names of the alternatives of unions."""
    place = []
    for key in location:
        is_key = key in value if isinstance(value, Mapping) else isinstance(key, int)
        if is_key and (isinstance(value, Mapping) or int(key) < len(value)):
            place.append(key)
            value = value[key]
    return tuple(place)


def _expected(problem: ErrorDetails) -> str:
    context = problem.get("ctx", {})
    if problem["type"] == "literal_error":
        names = str(context["expected"]).replace("'", "").replace(" or ", ", ")
        return f"one of {names}"
    if problem["type"] == "too_long":
        return f"a list of {context['max_length']}"
    return EXPECTED.get(problem["type"], problem["msg"])


def _shown(value: object) -> str:
    """Format a value as in YAML, shortened to 80 characters."""
    text = json.dumps(value) if value is None or isinstance(value, bool) else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
