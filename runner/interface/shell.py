"""What the command line takes and shows, as values of Python: its options and its tables."""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from seatrial.models.errors import ConfigurationError
from seatrial.runner import compare, database
from seatrial.runner.compare.figures import Several, split
from seatrial.runner.compare.grid import OutputFormat, TextTable, render
from seatrial.runner.configuration.invocation import meant, quoted
from seatrial.runner.record.vocabulary import GROUPS, Config

T = TypeVar("T")


class Displayed:
    """What a program and a notebook show as a table."""

    def _shown(self) -> TextTable:
        raise NotImplementedError

    def text(self, form: str = "rich") -> str:
        """Return the table in a format of the shell: rich, md, csv, latex or json."""
        return render(self._shown(), OutputFormat(form))

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return str(compare.page.html_table(self._shown()))


def overrides_of(options: Mapping[str, object]) -> list[str]:
    """Return the overrides of options by name; raises ConfigurationError for what has none.

    A double underscore stands for the dot of a nested option: `controller__kp=[1, 2, 3]` equals
    `controller={"kp": [1, 2, 3]}`. Objects become mappings, as `composition.spread` reads them.
    """
    texts = []
    for name, value in options.items():
        key = name.replace("__", ".")
        given = part_of(value, key) if key in GROUPS else value
        if given is None and key in GROUPS:
            raise ConfigurationError(f"{key}: got None or a model not stored, expected a choice")
        texts.append(f"{key}={text_of(given, key)}")
    return texts


def part_of(value: object, key: str) -> object:
    """Return an object, also inside of others, as the mapping that describes it; else the value.

    What a trial takes for a vessel or a model is its `part`: a name, or an object.
    """
    value = getattr(value, "part", value)
    if isinstance(value, Mapping):
        return {name: part_of(item, key) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [part_of(item, key) for item in value]
    if isinstance(value, type) or not is_dataclass(value):
        return value
    cls, given = type(value), dict[str, object]()
    if cls.__module__ == "__main__":
        expected = "a class of a module, which workers can import"
        raise ConfigurationError(f"{key}: got a class of the running script, expected {expected}")
    for option in fields(value):
        factory, item = option.default_factory, getattr(value, option.name)
        if option.init and item != (option.default if factory is MISSING else factory()):
            given[option.name] = item
    return {"_target_": f"{cls.__module__}.{cls.__qualname__}", **cast(Config, part_of(given, key))}


def text_of(value: object, key: str) -> str:
    """Return the value of an option in the grammar of overrides; a range is several, of a sweep."""
    if hasattr(value, "tolist"):  # of NumPy, which the command line does not import
        value = value.tolist()
    match value:
        case range():
            return f"range({value.start},{value.stop},{value.step})"
        case None | bool() | int() | float():
            return "null" if value is None else repr(value).lower()
        case str() | Path():
            return quoted(str(value))
        case Mapping():
            inner = (f"{name}:{text_of(item, key)}" for name, item in value.items())
            return "{" + ",".join(inner) + "}"
        case Iterable():
            return "[" + ",".join(text_of(item, key) for item in value) + "]"
    raise ConfigurationError(f"{key}: got {type(value).__name__}, expected text, numbers or a part")


def place_of(path: str | Path | None) -> list[str]:
    """Return the overrides for a logbook, given by its file or address; None: the default one."""
    if path is None:
        return []
    url = database.engine.url_of(path)
    file = Path(path) if url != str(path) else database.engine.parse(url).path
    series = [] if file is None else [f"results_dir={quoted(str(file.parent))}"]
    return [*series, f"database.url={quoted(url)}"]


def command_options(command: str, kind: type[T], given: Mapping[str, Any]) -> T:
    """Return the options of `table` or `plot`; several names are a list, or text with commas."""
    known = {option.name: option.type for option in fields(cast(Any, kind))}
    chosen: dict[str, object] = {}
    for name, value in given.items():
        if name not in known:
            expected = f"{meant(name, known)}expected one of {', '.join(known)}"
            raise ConfigurationError(f"{command}: no option {name!r}, {expected}")
        words = ",".join(value) if isinstance(value, list | tuple) else value
        is_text, several = known[name] in (str, str | None), known[name] == Several
        if value is not None:
            chosen[name] = list(split([words])) if several else str(words) if is_text else words
    return kind(**chosen)
