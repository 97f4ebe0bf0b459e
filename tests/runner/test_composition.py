"""Jobs composed from what they share are the jobs that Hydra composes, one by one."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import ReadonlyConfigError

from seatrial.runner.configuration.config import Limits
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.sweeps.composition import Composer, SharingLoader, order_of
from seatrial.runner.sweeps.job import Order
from seatrial.runner.sweeps.sweep import jobs_of

CHOICES = (
    *("identifier=ls", "identifier=none", "identifier=nothing", "controller=none", "~controller"),
    *("vessel=surge_linear", "disturbance=[noise,current]", "disturbance=wind", "identifier=null"),
    *("+experiment=positioning", "experiment=positioning", "+identifier@second=ridge"),
    *("database@elsewhere=sqlite", "excitation=prbs", "evaluation=square", "hydra.job.name=x"),
    *("hydra/launcher=basic", "~hydra.job.name", "++identifier=ls", "~evaluation=replay"),
)
KEYS = (
    *("seed", "plant.scale", "plant.change", "vessel.plant_scale", "results_dir", "dry_run"),
    *("vessel.tuning.reference.interval_s", "vessel.tuning.control.mission.speed.surge"),
    *("excitation.interval_s", "identifier.lowpass_hz", "identifier.lag_s", "controller.kp"),
    *("vessel.dofs", "excitation.axes", "evaluation.scale", "evaluation.reference.speed"),
    *("absent", "plant.absent.deep", "vessel", "controller", "metrics", "metrics.0", "update.at_s"),
    *("vessel.inertia.0.0", "vessel.inertia.1", "vessel.inertia.0.9", "vessel.dofs.2.x"),
)
VALUES = (
    *("0", "7", "-3", "1.5", "-0.0", "1e-3", "1_000", "007", "true", "null", "text", "'a b'"),
    *("nan", "inf", "[]", "[1,2,3]", "[1,[2,x]]", "{}", "{at_s:3,scale:0.5}", "{a:{b:[1]}}"),
    *("${seed}", "${plant.scale}", "${vessel.dofs}", "${.absent}", "'${plant.scale} m'", "???"),
    *("${oc.env:HOME}", "${oc.select:absent,3}", "${hydra:job.name}", "\\${seed}", "a\\,b", ""),
    *("${plant}", "${absent}", "int(3)", "'1'", "\\\\", "${hydra.job.name}", "$", "surge"),
)
# The name of a job's folder, of the overrides without this one.
NAMED = "hydra.job.config.override_dirname.exclude_keys=[name] +name=${hydra:job.override_dirname}"
overrides = st.sampled_from(CHOICES) | st.builds(
    lambda sign, key, value: f"~{key}" if sign == "~" else f"{sign}{key}={value}",
    st.sampled_from(["", "", "", "", "+", "++", "~", "~~"]),
    st.sampled_from(KEYS),
    st.sampled_from(VALUES),
).map(lambda text: text.replace("~~", "~"))
new_value = st.tuples(st.integers(0, 3), st.sampled_from(VALUES))


@pytest.fixture(scope="module")
def master() -> Iterator[DictConfig]:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield loader().load_configuration("trial", [], run_mode=RunMode.MULTIRUN)


def loader() -> Any:
    return GlobalHydra.instance().config_loader()


def told(compose: Callable[[list[str]], Order], job: list[str]) -> str:
    """What is made of a job, to the types of values and the order of keys; or its error."""
    try:
        order = compose(job)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return repr((order.config, order.names, order.overrides))


def by_hydra(master: DictConfig, job: list[str]) -> str:
    def compose(job: list[str]) -> Order:
        config = loader().load_sweep_config(master, job)
        HydraConfig.instance().set_config(config)
        task = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
        return order_of(task, config.hydra, job)

    return told(compose, job)


def varied(job: Sequence[str], values: Sequence[tuple[int, str]]) -> list[list[str]]:
    """The job, and the same with one value replaced after the other."""
    jobs = [list(job)]
    for index, value in values:
        after = list(jobs[-1])
        key, equals, _ = after[index % len(after)].partition("=")
        if equals and f"{key}=" not in " ".join(CHOICES):
            after[index % len(after)] = f"{key}={value}"
        jobs.append(after)
    return jobs


@pytest.mark.nightly
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(overrides, min_size=1, max_size=4), st.lists(new_value, max_size=3))
def test_jobs_that_share_are_those_of_hydra(
    master: DictConfig, first: list[str], values: list[tuple[int, str]]
) -> None:
    composer = Composer(SharingLoader(loader()), master)
    for job in varied(first, values):
        assert told(composer.order, job) == by_hydra(master, job), job


@pytest.mark.slow
@pytest.mark.parametrize(
    "jobs",
    [
        ["seed=3", "seed='1'", "seed=true", "seed=-0.0", "seed=???", "seed=1 absent=2"],
        ["vessel.plant_scale=2", "vessel.plant_scale=3"],  # plant.scale follows
        ["seed=${plant.scale} plant.scale=3", "seed=${.sample_time_s}", "seed=${.plant.scale}"],
        ["+a=${b} +b=${seed} seed=1", "+a=${hydra:job.name}", "+a=${hydra.job.name}"],
        ["identifier=ls identifier.lowpass_hz=0.5", "identifier.lowpass_hz=0.5 identifier=ls"],
        ["vessel=surge_linear +identifier.note=x", "excitation=prbs vessel.dofs=[sway,yaw]"],
        [f"{NAMED} seed=1", f"{NAMED} seed=2", "hydra.job.name=x seed=1", "+hydra.job.x=1 seed=1"],
        ["plant.change={at_s:1,scale:2}", "plant.change={scale:3}", "+new.x=1", "results_dir=a"],
        ["~controller seed=1", "~update seed=1", "~vessel.tuning sample_time_s=0.2", "~absent"],
        ["controller.kp=[1,2] controller={kp:[4]}", "controller.kp=auto", "controller.kp=4"],
        ["plant.scale=1 +plant.scale=2", "plant.scale=null +plant.scale=2", "++plant.scale=2"],
        ["vessel.tuning.pid.kp=[1,2,3] controller.ki=${vessel.tuning.pid.kp}"],
        ["vessel.inertia.0.0=2e3", "vessel.inertia.3.0=1", "~vessel.dofs.2", "~vessel.dofs=[a]"],
        ["identifier=glob(l*)", "identifier=absent", "vessel=[otter]", "disturbance=[noise,wind]"],
    ],
    ids=lambda jobs: jobs[0],
)
def test_a_job_after_another(master: DictConfig, jobs: list[str]) -> None:
    composer = Composer(SharingLoader(loader()), master)
    expected = [by_hydra(master, job.split()) for job in jobs]
    for job, outcome in zip([*jobs, jobs[0]], [*expected, expected[0]], strict=True):
        assert told(composer.order, job.split()) == outcome, job


@pytest.mark.parametrize(
    "job",
    ["identifier=ls seed=4", "hydra.job.name=x seed=1", "~controller", "hydra/launcher=processes"],
)
def test_what_is_shared_is_what_hydra_composes(master: DictConfig, job: str) -> None:
    sharing = SharingLoader(loader())
    slow = loader().load_sweep_config(master, job.split())
    HydraConfig.instance().set_config(slow)
    for sharer in (sharing, sharing, pickle.loads(pickle.dumps(sharing))):  # as in a worker
        fast = sharer.load_sweep_config(master, job.split())
        assert OmegaConf.to_yaml(fast) == OmegaConf.to_yaml(slow)
        assert OmegaConf.is_struct(fast)
        with open_dict(fast):  # as launchers do
            fast.hydra.job.num = 7
        HydraConfig.instance().set_config(fast)
        with pytest.raises(ReadonlyConfigError):
            fast.hydra.job.num = 8


def test_a_job_composes_nothing_that_another_has_chosen(
    master: DictConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    composed = []
    kind = type(loader())
    compose_all = kind.load_sweep_config

    def counted(self: Any, master: DictConfig, overrides: list[str]) -> Any:
        composed.append(overrides)
        return compose_all(self, master, overrides)

    monkeypatch.setattr(kind, "load_sweep_config", counted)
    sharing = SharingLoader(loader())
    for seed in range(5):
        for name in ("ls", "plsr"):
            copied = pickle.loads(pickle.dumps(sharing))  # a worker gets one with every job
            config = copied.load_sweep_config(master, [f"identifier={name}", f"seed={seed}"])
            assert config.seed == seed
    assert composed == [["identifier=ls"], ["identifier=plsr"]]


@pytest.mark.parametrize(
    ("argument", "count"),
    [("seed=range(0,3)", 3), ("plant.scale=range(0.5,2,0.25)", 6), ("identifier=glob(r*)", 2),
     ("controller.kp=choice([1,2],[3,4])", 2), ("+new=sort(3,1,2)", 3),
     ("identifier=ls,nothing", 2)],
)  # fmt: skip
def test_what_a_sweep_lists(master: DictConfig, argument: str, count: int) -> None:
    composer = Composer(SharingLoader(loader()), master)
    parser = OverridesParser.create(config_loader=loader())
    jobs = jobs_of(parser, {}, [], [argument, "sample_time_s=0.1,0.2"], Limits())
    assert len(jobs) == 2 * count
    for job in (jobs[0], jobs[-1]):
        assert told(composer.order, job) == by_hydra(master, job), job
