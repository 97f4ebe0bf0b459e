"""Options given in Python as overrides of the command line: `identifier__basis="physical"`."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, cast, get_type_hints

from seatrial.models.errors import ConfigurationError
from seatrial.runner import database
from seatrial.runner.compare.figures import Several, split
from seatrial.runner.configuration.invocation import meant, quoted
from seatrial.runner.record.vocabulary import GROUPS, Config

TARGET = "_target_"
NESTED = "__"  # in the name of an argument, for the dot of an option
Names = str | Sequence[str]
T = TypeVar("T")


def overrides_of(options: Mapping[str, object]) -> list[str]:
    """Return the overrides of options by name.

    A double underscore stands for the dot of a nested option, and a mapping for several options of
    one group: `controller__kp=[1, 2, 3]` equals `controller={"kp": [1, 2, 3]}`. A mapping with
    `_target_`, or a part as an object, replaces what a group has. Raises ConfigurationError for
    what is neither.
    """
    texts = []
    for name, value in options.items():
        key = name.replace(NESTED, ".")
        given = part_of(value, key) if key in GROUPS else value
        if key not in GROUPS or not isinstance(given, Mapping):
            texts.append(f"{key}={text_of(given)}")
        elif TARGET in given:
            texts += [f"~{key}", f"+{key}={text_of(given)}"]
        elif "name" in given:
            raise ConfigurationError(
                f"{key}: got a mapping with name and without {TARGET}, expected options of the one "
                f"that is chosen, or all of another one with its {TARGET}"
            )
        else:
            texts += [f"{key}.{inner}={text_of(item)}" for inner, item in given.items()]
    return texts


def part_of(value: object, key: str) -> object:
    """Return an object, also inside of others, as the mapping that describes it; else the value."""
    if isinstance(getattr(value, "choice", None), str):
        return value
    if not is_dataclass(value):
        value = getattr(value, "parameters", value)  # of a vessel from numbers
    if isinstance(value, Mapping):
        return {name: part_of(item, key) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [part_of(item, key) for item in value]
    if isinstance(value, type) or not is_dataclass(value):
        return value
    cls = type(value)
    if cls.__module__ == "__main__":
        raise ConfigurationError(
            f"{key}: got a {cls.__name__} of the running script, expected a class of a module, "
            "which workers can import"
        )
    given = {f.name: item for f in fields(value) if f.init
             if (item := getattr(value, f.name)) != _default(f)}  # fmt: skip
    return {TARGET: f"{cls.__module__}.{cls.__qualname__}", **cast(Config, part_of(given, key))}


def _default(option: "Field[object]") -> object:
    factory = option.default_factory
    return option.default if factory is MISSING else factory()


def text_of(value: object) -> str:
    """Return a value in the grammar of overrides.

    Takes numbers, text, paths, None, sequences, mappings, NumPy's values, a range (several values
    of a sweep), and vessels and models, which name themselves by `choice`. Raises
    ConfigurationError for anything else.
    """
    choice = getattr(value, "choice", None)
    if isinstance(choice, str):
        return text_of(choice)
    if isinstance(value, range):
        return f"range({value.start},{value.stop},{value.step})"
    if type(value).__module__ == "numpy":  # which the command line does not import
        value = cast(Any, value).tolist()
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | Path):
        return quoted(str(value))
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{text_of(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Iterable):
        return "[" + ",".join(map(text_of, value)) + "]"
    raise ConfigurationError(
        f"got a {type(value).__name__}, expected a number, text, None, a list or a mapping"
    )


def place_of(path: str | Path | None) -> list[str]:
    """Return the overrides for a logbook, given by its file or address; None: the default one."""
    if path is None:
        return []
    url = database.engine.url_of(path)
    file = Path(path) if url != str(path) else database.engine.parse(url).path
    series = [] if file is None else [f"results_dir={quoted(str(file.parent))}"]
    return [*series, f"database.url={quoted(url)}"]


def command_options(command: str, kind: type[T], given: Mapping[str, Any]) -> T:
    """Return the options of `table` or `plot` as the shell gives them.

    Several names are a list, or text with commas. Raises ConfigurationError for an unknown option.
    """
    hints, known = get_type_hints(kind), [field.name for field in fields(cast(Any, kind))]
    chosen: dict[str, object] = {}
    for name, value in given.items():
        if name not in known:
            expected = f"{meant(name, known)}expected one of {', '.join(known)}"
            raise ConfigurationError(f"{command}: no option {name!r}, {expected}")
        if value is None:
            continue
        names = not isinstance(value, str) and isinstance(value, Sequence)
        if hints[name] == Several:
            chosen[name] = list(split(value if names else [value]))
        elif hints[name] in (str, str | None):
            chosen[name] = ",".join(value) if names else str(value)
        else:
            chosen[name] = value
    return kind(**chosen)
