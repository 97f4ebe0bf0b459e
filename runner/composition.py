"""Composition of the configurations of a sweep's jobs, with shared configurations.

Hydra takes a tenth of a second to compose a job from its files. Jobs that choose the same options
from the groups and differ in values only (replicates over seeds, grids of parameters) share one
composed configuration. Their values are set in it as Hydra sets them, when the sweep is planned and
when a launcher runs its jobs, here or in workers.
"""

import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import cast
from uuid import uuid4

from hydra.conf import HydraConf
from hydra.core.config_loader import ConfigLoader
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from seatrial.runner.job import Order
from seatrial.runner.tuning_values import check_tuning
from seatrial.runner.vocabulary import GROUPS


def order_of(
    task: DictConfig, hydra: DictConfig | HydraConf, overrides: list[str] | None = None
) -> Order:
    """Return the order of a composed configuration; `hydra` is Hydra's part of it."""
    config = cast(
        dict[str, object], OmegaConf.to_container(task, resolve=True, throw_on_missing=True)
    )
    choices = hydra.runtime.choices
    if overrides is None:
        overrides = list(hydra.overrides.task)
    vessel = config.get("vessel")
    tuning = vessel.get("tuning") if isinstance(vessel, dict) else None
    if isinstance(tuning, dict):
        folders = [item.path for item in hydra.runtime.config_sources if item.schema == "file"]
        check_tuning(tuning, folders, [*map(str, hydra.overrides.task), *overrides])
    return Order(
        config=config,
        names={group: _name(group, choices, overrides) for group in GROUPS},
        overrides=overrides,
    )


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
        parsed = OverridesParser.create(config_loader=self.hydra).parse_overrides(sweep_overrides)
        split = self.split(parsed)
        if split is None:
            return self.hydra.load_sweep_config(master_config, sweep_overrides)
        choices, values = split
        config = deepcopy(self.base(master_config, choices))
        try:
            set_values(config, values)
        except OmegaConfBaseException:  # Hydra raises its own error
            return self.hydra.load_sweep_config(master_config, sweep_overrides)
        hydra, task = config.hydra, [item for item in parsed if not item.is_hydra_override()]
        with open_dict(hydra), read_write(hydra):
            hydra.overrides.task = [override.input_line for override in task]
            hydra.job.override_dirname = _dirname(task, hydra.job.config.override_dirname)
        OmegaConf.copy_cache(from_config=master_config, to_config=config)
        return config

    def split(self, job: Sequence[Override]) -> tuple[list[str], list[Override]] | None:
        """Split a job into the options it chooses and the values it sets; None if not possible."""
        choices: list[str] = []
        values: list[Override] = []
        for override in job:
            if not _plain(override):  # + and ~ may depend on the overrides before them
                return None
            if override.is_hydra_override() or self._chooses(override.key_or_group):
                choices.append(str(override.input_line))
            else:
                values.append(override)
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


def set_values(config: DictConfig, values: Sequence[Override]) -> None:
    """Set values in a composed configuration; raises OmegaConfBaseException."""
    for override in values:
        OmegaConf.update(config, override.key_or_group, override.value(), merge=True)


def _dirname(overrides: Sequence[Override], form: DictConfig) -> str:
    """Return the value of `hydra.job.override_dirname`."""
    items = [item for item in overrides if item.key_or_group not in form.exclude_keys]
    texts = sorted(str(item.input_line) for item in items)
    return str(form.item_sep).join(texts).replace("=", form.kv_sep)


def _plain(override: Override) -> bool:
    special = override.is_add() or override.is_force_add() or override.is_delete()
    return not special and override.package is None


class Composer:
    """Composes the jobs of one sweep; `master` is the sweep's own configuration."""

    def __init__(self, loader: SharingLoader, master: DictConfig) -> None:
        self._loader = loader
        self._master = master
        self._parser = OverridesParser.create(config_loader=loader.hydra)
        self._choices: list[str] | None = None
        self._config = self._task = master

    def order(self, job: list[str]) -> Order:
        """Return the order of one job; raises errors of Hydra and OmegaConf."""
        split = self._loader.split(self._parser.parse_overrides(job))
        if split is None:
            return self._composed_by_hydra(job)
        choices, values = split
        if choices != self._choices:  # the next jobs often choose the same
            self._choices, self._config = choices, self._loader.base(self._master, choices)
            self._task = _task_of(self._config)
            HydraConfig.instance().set_config(self._config.copy())
        task = deepcopy(self._task)
        try:
            set_values(task, values)
        except OmegaConfBaseException:
            return self._composed_by_hydra(job)  # Hydra raises its own error
        return order_of(task, self._config.hydra, job)

    def _composed_by_hydra(self, job: list[str]) -> Order:
        self._choices = None
        config = self._loader.load_sweep_config(self._master, job)
        HydraConfig.instance().set_config(config)
        return order_of(_task_of(config), config.hydra, job)


def _task_of(config: DictConfig) -> DictConfig:
    """Copy a configuration without Hydra's part."""
    return OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
