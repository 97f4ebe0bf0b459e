"""Composition of the configurations of a sweep's jobs.

Hydra takes a quarter of a second to compose a job from its files. Jobs that choose the same options
from the groups share one composition; the values of each job are then set in a copy of it, as Hydra
sets them. Sweeps compose so when they are planned, and launchers when they run their jobs, here or
in workers. Jobs that cannot be split in this way are composed by Hydra, and so are those that Hydra
refuses, which raises its own errors.
"""

import pickle
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from functools import lru_cache
from io import BytesIO
from types import MappingProxyType, SimpleNamespace
from typing import Any, cast
from uuid import uuid4

from hydra.conf import HydraConf
from hydra.core.config_loader import ConfigLoader
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, QuotedString, Sweep
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.vessel_options import SUITED_GROUPS, filled, suited_parts
from seatrial.runner.record.vocabulary import GROUPS, Config
from seatrial.runner.sweeps.job import Order
from seatrial.runner.sweeps.yaml_files import FileConfigSource

NOT_OF_TRIAL = ("hydra", "search")  # parts of a configuration for Hydra, and for a search


def order_of(
    config: DictConfig, hydra: DictConfig | HydraConf, overrides: list[str] | None = None
) -> Order:
    """Return the order of a composed configuration.

    Args:
        config: the configuration, without Hydra's part.
        hydra: Hydra's part.
        overrides: those of the job; None takes them from Hydra's part.
    """
    if overrides is None:  # their interpolations are not for Hydra's part
        overrides = cast(list[str], OmegaConf.to_container(cast(Any, hydra.overrides.task)))
    names = {
        group: _name(group, hydra.runtime.choices, overrides, config.get(group)) for group in GROUPS
    }
    return Order(config=filled(_resolved(config)), names=names, overrides=overrides)


def _name(group: str, choices: Mapping[str, object], overrides: list[str], node: object) -> str:
    """Return the option chosen from a group; `a+b` for a list, which Hydra does not report.

    A part that is given whole, not chosen, has the name of itself, else of its class.
    """
    if choices.get(group):
        return str(choices[group])
    lists = [text.partition("=[")[2] for text in overrides if text.startswith(f"{group}=[")]
    names = re.findall(r"[^\s,'\"\]]+", lists[-1]) if lists else []
    if names[1:] and group != "disturbance":  # whose parts add up
        several = f"a sweep has several: -m {group}={','.join(names)}"
        raise ConfigurationError(f"{group}: got [{','.join(names)}], expected one; {several}")
    if names:
        return "+".join(names)
    whole = node if isinstance(node, DictConfig) else {}
    return str(whole.get("name") or str(whole.get("_target_", "none")).rpartition(".")[2])


def _resolved(config: DictConfig) -> dict[str, object]:
    """Return the part of a configuration that describes the trial, without interpolations."""
    return {
        key: OmegaConf.to_container(value, resolve=True, throw_on_missing=True)
        if OmegaConf.is_config(value := config[key])
        else value
        for key in map(str, config)
        if key not in NOT_OF_TRIAL
    }


def with_numbers(config: DictConfig) -> DictConfig:
    """Return a composed configuration in which options taken from the vessel are numbers.

    Other options stay as they are, with their interpolations.
    """
    shown = deepcopy(config)
    if "vessel" in config:
        plain = _resolved(config)
        with open_dict(shown), read_write(shown):
            _set_changes(shown, plain, filled(plain))
    return shown


def _set_changes(target: DictConfig, before: Config, after: Config) -> None:
    """Set in `target` what differs between two nodes of its resolved configuration."""
    for key, value in after.items():
        if key in before and value == before[key]:
            continue
        node = target._get_node(key)
        inner = isinstance(value, dict) and isinstance(before.get(key), dict)
        if inner and isinstance(node, DictConfig) and not node._is_interpolation():
            _set_changes(node, before[key], value)
        else:
            target[key] = value


class Refused(Exception):  # noqa: N818
    """An override that Hydra refuses."""


def set_values(config: DictConfig, overrides: Sequence[Override]) -> None:
    """Set values in their order, as Hydra does; raises Refused where Hydra raises its own error."""
    try:
        for override in overrides:
            key, value = override.key_or_group, override.value()
            present: Any = None
            if override.is_add() or override.is_delete():
                present = OmegaConf.select(config, key, throw_on_missing=False)
            if override.is_delete():
                if present is None or (value is not None and value != present):
                    raise Refused(override.input_line)
                parent, _, last = key.rpartition(".")
                with open_dict(config):
                    node: Any = OmegaConf.select(config, parent) if parent else config
                    del node[last]
            elif present is not None and not isinstance(value, dict | list):
                raise Refused(override.input_line)
            else:
                force = override.is_add() or override.is_force_add()
                OmegaConf.update(config, key, value, merge=True, force_add=force)
    except (OmegaConfBaseException, AttributeError, TypeError, ValueError, AssertionError) as error:
        raise Refused(str(error)) from error


class SharingLoader:
    """Composes the jobs of one sweep; jobs that choose the same options share a composition.

    It replaces Hydra's loader in launchers, which call only `load_sweep_config`. Its copies in one
    worker share their compositions.
    """

    KEPT = 64  # largest number of compositions; the oldest is dropped
    # Of the last sweep: its identifier, and the composition of each combination of choices.
    _shared: "tuple[str, dict[tuple[str, ...], _Stored]]" = ("", {})

    def __init__(self, loader: ConfigLoader) -> None:
        self.hydra = loader
        self._sweep = uuid4().hex
        self._is_group: dict[str, bool] = {}

    def load_sweep_config(
        self, master_config: DictConfig, sweep_overrides: list[str]
    ) -> DictConfig:
        """Return the configuration of a job, as Hydra composes it."""
        split = self.split(sweep_overrides)
        if split is None:
            return self._by_hydra(master_config, sweep_overrides)
        choices, values = split
        try:
            config = self.composition(master_config, choices)
            set_values(config, values)
        except (HydraException, OmegaConfBaseException, Refused):
            return self._by_hydra(master_config, sweep_overrides)
        hydra, task = config.hydra, [o for o in map(_parsed, sweep_overrides) if _is_task(o)]
        form = hydra.job.config.override_dirname
        named = [str(o.input_line) for o in task if o.key_or_group not in form.exclude_keys]
        with open_dict(hydra), read_write(hydra):
            hydra.overrides.task = [override.input_line for override in task]
            dirname = str(form.item_sep).join(sorted(named))
            hydra.job.override_dirname = dirname.replace("=", form.kv_sep)
        OmegaConf.copy_cache(from_config=master_config, to_config=config)
        return config

    def split(self, job: Sequence[str]) -> tuple[list[str], list[Override]] | None:
        """Split a job into the options it chooses and the values it sets; None if not possible.

        Hydra sets values after all choices, in their order. Values of Hydra's own options go with
        the choices. Raises errors of Hydra for overrides that cannot be read.
        """
        choices: list[str] = []
        values: list[Override] = []
        for override in map(_parsed, job):
            key = override.key_or_group
            if override.is_sweep_override() or key == "hydra":
                return None
            if key not in self._is_group:
                self._is_group[key] = bool(self.hydra.get_group_options(key))
            whole = override.is_add() and isinstance(override.value(), dict)  # in place of a choice
            if self._is_group[key] and (whole or not isinstance(override.value(), dict)):
                choices.append(str(override.input_line))
            elif override.package is not None:
                return None
            elif _is_task(override):
                values.append(override)
            elif override.is_add() or override.is_delete():  # depends on what is there before
                return None
            else:
                choices.append(str(override.input_line))
        return choices, values

    def composition(self, master: DictConfig, choices: Sequence[str]) -> DictConfig:
        """Return a copy of the configuration of the choices alone; raises errors of Hydra."""
        sweep, composed = SharingLoader._shared
        if sweep != self._sweep:
            composed = {}
            SharingLoader._shared = self._sweep, composed
        key = tuple(choices)
        if key not in composed:
            if len(composed) >= self.KEPT:
                del composed[next(iter(composed))]
            composed[key] = _Stored(self._by_hydra(master, list(choices)))
        return composed[key].copy()

    def _by_hydra(self, master: DictConfig, overrides: list[str]) -> DictConfig:
        FileConfigSource.job = overrides  # which a vessel's own choices follow
        try:
            return self.hydra.load_sweep_config(master, overrides)
        finally:
            FileConfigSource.job = None


@lru_cache(maxsize=4096)  # the jobs of a sweep have most of their overrides in common
def _parsed(text: str) -> Override:
    override: Override = OverridesParser.create().parse_override(text)
    return override


def _is_task(override: Override) -> bool:
    return not override.is_hydra_override()


class _Stored:
    """A configuration that is copied by pickle, in a third of the time of a deep copy.

    Its classes stay what they are: Hydra imports those of launchers twice, which pickle refuses.
    """

    def __init__(self, config: DictConfig) -> None:
        self._classes: list[type] = []
        file = BytesIO()
        pickler = _Pickler(file)
        pickler.classes = self._classes
        pickler.dump(config)
        self._data = file.getvalue()

    def copy(self) -> DictConfig:
        unpickler = _Unpickler(BytesIO(self._data))
        unpickler.classes = self._classes
        config: DictConfig = unpickler.load()
        return config


class _Pickler(pickle.Pickler):
    classes: list[type]

    def persistent_id(self, value: Any) -> int | None:
        if not isinstance(value, type):
            return None
        self.classes.append(value)
        return len(self.classes) - 1


class _Unpickler(pickle.Unpickler):
    classes: list[type]

    def persistent_load(self, index: Any) -> Any:
        return self.classes[index]


class Alternatives:
    """Orders of trials that differ in the option of one group.

    All options of the groups are composed once, with the first vessel; those of a trial are put
    into the composition of its vessel, with the excitation and the controller that suit them.

    Args:
        loader: Hydra's.
        vessel: the first vessel.
        given: the choices that all trials have in common, by group.
        groups: the names of the options that are tried, by group.
    """

    def __init__(
        self, loader: ConfigLoader, vessel: str, given: Mapping[str, str],
        groups: Mapping[str, Sequence[str]],
    ) -> None:  # fmt: skip
        self._loader, self._given = loader, [f"{group}={name}" for group, name in given.items()]
        beside = [f"+{g}@beside.{g}.{name}={name}" for g, names in groups.items() for name in names]
        self._options = self._composed([f"vessel={vessel}", *self._given, *beside]).beside
        self._vessel, self._base, self._node = "", DictConfig({}), cast(Config, {})

    def _composed(self, words: list[str]) -> DictConfig:
        FileConfigSource.job = words
        try:
            return self._loader.load_configuration("trial", words, run_mode=RunMode.RUN)
        finally:
            FileConfigSource.job = None

    def order(self, vessel: str, group: str, name: str) -> Order:
        """Return the order of a vessel with the option of a group; raises errors as a composer."""
        words = [f"vessel={vessel}", *self._given]
        if vessel != self._vessel:
            self._vessel, self._base = vessel, self._composed(words)
            self._node = cast(Config, OmegaConf.to_container(self._base.vessel, resolve=True))
        base, chosen = self._base, {group: name}
        names = base.hydra.runtime.choices
        if group in SUITED_GROUPS:  # where the vessel has chosen, it follows what is named
            before = suited_parts(self._node, words)
            after = suited_parts(self._node, [*words, f"{group}={name}"])
            free = (each for each in after if each in self._options and names[each] == before[each])
            chosen = {each: after[each] for each in free} | chosen
        kept = {each: (base[each], names[each]) for each in chosen}
        with open_dict(base), read_write(base):
            try:
                for each, option in chosen.items():
                    base[each], names[each] = self._options[each][option], option
                return order_of(base, base.hydra, [*words, f"{group}={name}"])
            finally:
                for each, (node, option) in kept.items():
                    base[each], names[each] = node, option


class Composer:
    """Composes the orders of one sweep; `master` is the sweep's own configuration."""

    def __init__(self, loader: SharingLoader, master: DictConfig) -> None:
        self._loader = loader
        self._master = master
        self._has_option: dict[tuple[tuple[str, ...], str], bool] = {}  # by choices and key

    def order(self, job: list[str]) -> Order:
        """Return the order of one job; raises errors of Hydra and OmegaConf."""
        config = self._loader.load_sweep_config(self._master, job)
        hydra = config.hydra
        with open_dict(config), read_write(config):
            del config["hydra"]
        # For interpolations such as ${hydra:job.name}. Hydra's own `set_config` copies the part,
        # which takes a third of the time of planning; what is moved is as much apart as its copy.
        HydraConfig.instance().cfg = cast(Any, SimpleNamespace(hydra=hydra))
        return order_of(config, hydra, job)

    def choices(self, job: list[str]) -> list[str]:
        """Return the options that a job chooses; empty if it cannot be split or read."""
        return self._split(job)[0]

    def _split(self, job: list[str]) -> tuple[list[str], list[Override]]:
        try:
            return self._loader.split(job) or ([], [])
        except HydraException:
            return [], []

    def applicable(self, jobs: Sequence[list[str]]) -> list[list[str]]:
        """Leave out of each job the options that its choices do not have but another job's do."""
        lacking = [self._lacking(job) for job in jobs]
        if not any(lacking):
            return list(jobs)
        keys = [{text.partition("=")[0] for text in job} for job in jobs]
        known = set[str]().union(*(own - bare for own, bare in zip(keys, lacking, strict=True)))
        shorter = (
            tuple(text for text in job if text.partition("=")[0] not in bare & known)
            for job, bare in zip(jobs, lacking, strict=True)
        )
        return [list(job) for job in dict.fromkeys(shorter)]

    def _lacking(self, job: list[str]) -> set[str]:
        """Return the options of a group that a job sets but its choices do not have."""
        choices, values = self._split(job)
        keys = {value.key_or_group for value in values if not (value.is_add() or value.is_delete())}
        of_groups = {key for key in keys if "." in key and key.partition(".")[0] in GROUPS}
        return {key for key in of_groups if not self._has(tuple(choices), key)}

    def _has(self, choices: tuple[str, ...], key: str) -> bool:
        if (choices, key) not in self._has_option:
            parent, _, name = key.rpartition(".")
            try:
                node = OmegaConf.select(self._loader.composition(self._master, choices), parent)
            except (HydraException, OmegaConfBaseException):
                return True  # the composition of the job reports it
            has = isinstance(node, DictConfig) and name in list(node.keys())
            self._has_option[choices, key] = has
        return self._has_option[choices, key]


def spread(words: Sequence[str]) -> list[str]:
    """Return overrides without mappings of groups, given as `GROUP={...}`.

    One with `_target_` replaces what the group has, any other sets options of it. Raises
    ConfigurationError for a name without a class: it would be that of the group's own part.
    """
    result, keys = list[str](), {word.partition("=")[0] for word in words}
    for word in words:
        group, _, text = word.lstrip("+").partition("=")
        value: object = None
        if group in GROUPS and "={" in word and f"~{group}" not in keys:
            with suppress(HydraException):  # said by Hydra itself
                value = cast(Any, _parsed(word))._value  # with its quotes
        if not isinstance(value, dict):
            result.append(word)
        elif "_target_" in value:
            result += [f"~{group}", f"+{group}={text}"]
        elif "name" in value:
            expected = f"expected {group}={value['name']}, or options without a name"
            raise ConfigurationError(f"{group}: got a name without _target_, {expected}")
        else:
            result += [f"{group}.{key}={text_of(item)}" for key, item in value.items()]
    return result


def left_to_jobs(
    words: Sequence[str], variants: Sequence[Sequence[str]]
) -> tuple[list[str], list[list[str]]]:
    """Return the words of a sweep's command line, and its variants with what is left to the jobs.

    Hydra applies a plain override to the default of its group first, which may not have the option:
    `identifier=none,ls identifier.basis=physical`. As a part of every variant it is for the jobs.
    So is a list with sweeps, which no configuration can hold.
    """
    words, parser = spread(words), OverridesParser.create()

    def parsed(word: str) -> Override | None:
        try:
            return parser.parse_override(word)
        except HydraException:  # said by Hydra itself
            return None

    overrides = {word: override for word in words if "=" in word and (override := parsed(word))}
    swept = {each.key_or_group for each in overrides.values() if each.is_sweep_override()}
    swept |= {text.partition("=")[0] for variant in variants for text in variant}

    def is_left(override: Override) -> bool:
        group, dot, _ = override.key_or_group.partition(".")
        plain = not (override.is_sweep_override() or override.is_delete())
        several = plain and next(nested_sweeps(override.value(), ""), None) is not None
        return several or (plain and bool(dot) and group in swept & set(GROUPS))

    left = [word for word, override in overrides.items() if is_left(override)]
    if not left:
        return list(words), [list(variant) for variant in variants]
    kept = [word for word in words if word not in left]
    return kept, [[*left, *variant] for variant in variants or [()]]


def nested_sweeps(value: object, name: str) -> Iterator[tuple[str, Sweep]]:
    """Yield the sweeps of an override's value, also in its lists, by `name`, `name[0]`, ..."""
    if isinstance(value, Sweep):
        yield name, value
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from nested_sweeps(inner, f"{name}[{i}]")
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from nested_sweeps(inner, f"{name}.{key}")


def text_of(value: Any, name: str = "", values: Mapping[str, Any] = MappingProxyType({})) -> str:
    """Return a value in the grammar of the command line; `values` are those of its sweeps."""
    if isinstance(value, Sweep):
        return str(values[name])
    if isinstance(value, list):
        return f"[{','.join(text_of(v, f'{name}[{i}]', values) for i, v in enumerate(value))}]"
    if isinstance(value, dict):
        inner = (f"{key}:{text_of(v, f'{name}.{key}', values)}" for key, v in value.items())
        return "{" + ",".join(inner) + "}"
    if isinstance(value, QuotedString):
        return str(value.with_quotes())
    text = "null" if value is None else str(value)
    return text.lower() if isinstance(value, bool) else text
