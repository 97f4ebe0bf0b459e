"""Composition of the configurations of a sweep's jobs, with shared configurations.

Hydra takes a tenth of a second to compose a job from its files. Jobs that choose the same options
from the groups and differ in values only (replicates over seeds, grids of parameters) share one
composed configuration. Their values are set in it as Hydra sets them, when the sweep is planned and
when a launcher runs its jobs, here or in workers.
"""

import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import cast
from uuid import uuid4

from hydra.conf import HydraConf
from hydra.core.config_loader import ConfigLoader
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from seatrial.runner.job import Order
from seatrial.runner.overrides import Parser, Refused, apply
from seatrial.runner.resolution import Resolution, check_size, interpolations, pure, shape, text_of
from seatrial.runner.vessel_options import VesselOptions
from seatrial.runner.vocabulary import GROUPS, Config


def order_of(
    task: DictConfig, hydra: DictConfig | HydraConf, overrides: list[str] | None = None
) -> Order:
    """Return the order of a composed configuration; `hydra` is Hydra's part of it."""
    if overrides is None:
        overrides = _given(hydra)
    config = VesselOptions().filled(_resolve(_task_of(task)))
    return Order(config=config, names=_names(hydra, overrides), overrides=overrides)


def with_numbers(config: DictConfig) -> DictConfig:
    """Return a composed configuration in which options taken from the vessel are numbers.

    Other options stay as they are, with their interpolations.
    """
    shown = deepcopy(config)
    task = _task_of(config)
    if "vessel" in task:
        plain = _resolve(task)
        with open_dict(shown), read_write(shown):
            _set_changes(shown, plain, VesselOptions().filled(plain))
    return shown


def _set_changes(target: DictConfig, before: Config, after: Config) -> None:
    """Set in `target` what differs between two nodes of its resolved configuration."""
    for key, value in after.items():
        if key in before and value is before[key]:
            continue
        node = target._get_node(key)
        inner = isinstance(value, dict) and isinstance(before.get(key), dict)
        if inner and isinstance(node, DictConfig) and not node._is_interpolation():
            _set_changes(node, before[key], value)
        else:
            target[key] = value


def _given(hydra: DictConfig | HydraConf) -> list[str]:
    """Return the overrides as they were given: their interpolations are not for Hydra's part."""
    return cast(list[str], OmegaConf.to_container(cast(ListConfig, hydra.overrides.task)))


def _resolve(task: DictConfig) -> dict[str, object]:
    check_size(task)
    return cast(
        dict[str, object], OmegaConf.to_container(task, resolve=True, throw_on_missing=True)
    )


def _names(hydra: DictConfig | HydraConf, overrides: list[str]) -> dict[str, str]:
    return {group: _name(group, hydra.runtime.choices, overrides) for group in GROUPS}


def _name(group: str, choices: Mapping[str, object], overrides: list[str]) -> str:
    """Return the option chosen from a group; `a+b` for a list, which Hydra does not report."""
    if choices.get(group):
        return str(choices[group])
    lists = [text.partition("=[")[2] for text in overrides if text.startswith(f"{group}=[")]
    return "+".join(re.findall(r"\w+", lists[-1])) if lists else "none"


class SharingLoader:
    """Composes the jobs of one sweep; jobs that choose the same options share a configuration.

    It replaces Hydra's loader in launchers, which call only `load_sweep_config`. Its copies in one
    worker share their configurations.
    """

    KEPT = 64  # largest number of composed configurations; the oldest is dropped
    _shared: dict[str, dict[tuple[str, ...], DictConfig]] = {}  # noqa: RUF012 - of the last sweep

    def __init__(self, loader: ConfigLoader) -> None:
        self.hydra = loader
        self._sweep = uuid4().hex
        self._is_group: dict[str, bool] = {}

    def load_sweep_config(
        self, master_config: DictConfig, sweep_overrides: list[str]
    ) -> DictConfig:
        """Return the configuration of a job, as Hydra composes it."""
        parsed = Parser(self.hydra).parse(sweep_overrides)
        split = self.split(parsed)
        if split is None:
            return self.hydra.load_sweep_config(master_config, sweep_overrides)
        choices, values = split
        config = deepcopy(self.base(master_config, choices))
        try:
            apply(config, values)
        except Refused:  # Hydra raises its own error
            return self.hydra.load_sweep_config(master_config, sweep_overrides)
        hydra, task = config.hydra, [item for item in parsed if not item.is_hydra_override()]
        with open_dict(hydra), read_write(hydra):
            hydra.overrides.task = [override.input_line for override in task]
            hydra.job.override_dirname = _dirname(task, hydra.job.config.override_dirname)
        OmegaConf.copy_cache(from_config=master_config, to_config=config)
        return config

    def split(self, job: Sequence[Override]) -> tuple[list[str], list[Override]] | None:
        """Split a job into the options it chooses and the values it sets; None if not possible.

        Hydra sets values after all choices, in their order. Values of Hydra's own options go with
        the choices.
        """
        choices: list[str] = []
        values: list[Override] = []
        for override in job:
            chooses = self._chooses(override.key_or_group)
            if override.is_sweep_override() or override.key_or_group == "hydra":
                return None
            if chooses and not isinstance(override.value(), dict):
                choices.append(str(override.input_line))
            elif override.package is not None:
                return None
            elif not override.is_hydra_override():
                values.append(override)
            elif override.is_add() or override.is_delete():  # depends on what is there before
                return None
            else:
                choices.append(str(override.input_line))
        return choices, values

    def base(self, master: DictConfig, choices: list[str]) -> DictConfig:
        """Return the configuration of the choices alone; the caller must not change it."""
        if self._sweep not in self._shared:
            self._shared.clear()
        composed = self._shared.setdefault(self._sweep, {})
        key = tuple(choices)
        if key not in composed:
            if len(composed) >= self.KEPT:
                del composed[next(iter(composed))]
            composed[key] = self.hydra.load_sweep_config(master, choices)
        return composed[key]

    def _chooses(self, key: str) -> bool:
        if key not in self._is_group:
            self._is_group[key] = bool(self.hydra.get_group_options(key))
        return self._is_group[key]


def _dirname(overrides: Sequence[Override], form: DictConfig) -> str:
    """Return the value of `hydra.job.override_dirname`."""
    items = [item for item in overrides if item.key_or_group not in form.exclude_keys]
    texts = sorted(str(item.input_line) for item in items)
    return str(form.item_sep).join(texts).replace("=", form.kv_sep)


@dataclass(frozen=True)
class _Chosen:
    """The configuration of some choices, without Hydra's part, and the names of the options."""

    task: DictConfig
    names: dict[str, str]
    pure: bool  # its interpolations depend on the configuration and the environment only


class Composer:
    """Composes the jobs of one sweep; `master` is the sweep's own configuration."""

    KEPT = 64  # largest number of resolutions; the oldest is dropped

    def __init__(self, loader: SharingLoader, master: DictConfig) -> None:
        self._loader = loader
        self._master = master
        self._parser = Parser(loader.hydra)
        self._choices: list[str] | None = None
        self._chosen: _Chosen | None = None
        self._resolutions: dict[tuple[str, ...], Resolution] = {}
        self._options: dict[tuple[tuple[str, ...], str], bool] = {}  # by choices and key
        self._vessel_options = VesselOptions()

    def choices(self, job: list[str]) -> list[str]:
        """Return the options that a job chooses; empty if it cannot be split or read."""
        try:
            split = self._loader.split(self._parser.parse(job))
        except HydraException:
            return []
        return split[0] if split is not None else []

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
        try:
            split = self._loader.split(self._parser.parse(job))
        except HydraException:
            return set()
        if split is None:
            return set()
        choices, values = split
        keys = (value.key_or_group for value in values if not (value.is_add() or value.is_delete()))
        return {key for key in keys if _group_of(key) and not self._has(tuple(choices), key)}

    def _has(self, choices: tuple[str, ...], key: str) -> bool:
        if (choices, key) not in self._options:
            parent, _, name = key.rpartition(".")
            try:
                node = OmegaConf.select(self._loader.base(self._master, list(choices)), parent)
            except (HydraException, OmegaConfBaseException):
                return True  # the composition of the job reports it
            self._options[choices, key] = isinstance(node, DictConfig) and name in list(node.keys())
        return self._options[choices, key]

    def order(self, job: list[str]) -> Order:
        """Return the order of one job; raises errors of Hydra and OmegaConf."""
        split = self._loader.split(self._parser.parse(job))
        if split is None:
            return self._composed_by_hydra(job)
        choices, values = split
        if choices != self._choices or self._chosen is None:  # the next jobs often choose the same
            try:
                self._chosen = self._choose(choices, job)
            except Exception:  # Hydra raises its own error about the complete job
                return self._composed_by_hydra(job)
            self._choices = choices
            self._resolutions.clear()
        chosen = self._chosen
        if not chosen.pure or not all(pure(str(override.input_line)) for override in values):
            return self._composed_by_hydra(job)
        config = self._resolved(chosen, values)
        if config is not None:
            return self._order(config, chosen, job)
        task = deepcopy(chosen.task)
        try:
            apply(task, values)
        except Refused:
            return self._composed_by_hydra(job)  # Hydra raises its own error
        return self._order(_resolve(task), chosen, job)

    def _order(self, config: dict[str, object], chosen: _Chosen, job: list[str]) -> Order:
        filled = self._vessel_options.filled(config)
        return Order(config=filled, names=chosen.names, overrides=job)

    def _choose(self, choices: list[str], job: list[str]) -> _Chosen:
        config = self._loader.base(self._master, choices)
        task = _task_of(config)
        names = _names(config.hydra, job)
        texts = [text_of(container, key) for container, key, _ in interpolations(task)]
        return _Chosen(task, names, all(map(pure, texts)))

    def _resolved(self, chosen: _Chosen, values: Sequence[Override]) -> dict[str, object] | None:
        """Return the configuration of a job from that of another job; None if not possible."""
        form = shape(values)
        if form is None:
            return None
        try:
            if form not in self._resolutions:
                if len(self._resolutions) >= self.KEPT:
                    del self._resolutions[next(iter(self._resolutions))]
                self._resolutions[form] = Resolution(deepcopy(chosen.task), values)
            return self._resolutions[form].resolved(values)
        except (Refused, OmegaConfBaseException):
            self._resolutions.pop(form, None)
            return None

    def _composed_by_hydra(self, job: list[str]) -> Order:
        config = self._loader.hydra.load_sweep_config(self._master, job)
        HydraConfig.instance().set_config(config)
        return order_of(_task_of(config), config.hydra, job)


def _group_of(key: str) -> str:
    """Return the group that an option belongs to; empty for the options of every trial."""
    group, dot, _ = key.partition(".")
    return group if dot and group in GROUPS else ""


def _task_of(config: DictConfig) -> DictConfig:
    """Copy a configuration without Hydra's part and that of a search, which are not of the trial.

    Unknown options are refused as before.
    """
    own = [str(key) for key in config if key not in ("hydra", "search")]
    task: DictConfig = OmegaConf.masked_copy(config, own)
    OmegaConf.set_struct(task, OmegaConf.is_struct(config))
    return task
