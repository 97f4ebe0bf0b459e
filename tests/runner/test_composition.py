"""Jobs composed from what they share are the jobs that Hydra composes, one by one."""

from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf

from seatrial.runner.composition import Composer, SharingLoader, order_of
from seatrial.runner.config import Limits
from seatrial.runner.hydra_errors import CONF, EXPECTED
from seatrial.runner.overrides import Parser
from seatrial.runner.sweep import jobs_of

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
OWN = "vessel.tuning.pid.kp=[1,2,3]"
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


def by_hydra(master: DictConfig, job: list[str]) -> str:
    """What Hydra makes of a job, to the types of values and the order of keys; or its error."""
    try:
        config = loader().load_sweep_config(master, job)
        HydraConfig.instance().set_config(config)
        task = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
        order = order_of(task, config.hydra, job)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return repr((order.config, order.names, order.overrides))


def shared(composer: Composer, job: list[str]) -> str:
    try:
        order = composer.order(job)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return repr((order.config, order.names, order.overrides))


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


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(overrides, min_size=1, max_size=4), st.lists(new_value, max_size=3))
def test_jobs_that_share_are_those_of_hydra(
    master: DictConfig, first: list[str], values: list[tuple[int, str]]
) -> None:
    composer = Composer(SharingLoader(loader()), master)
    for job in varied(first, values):
        assert shared(composer, job) == by_hydra(master, job), job


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("vessel.plant_scale=2 seed=1", "vessel.plant_scale=3 seed=1"),  # plant.scale follows
        ("plant.scale=${seed} seed=1", "plant.scale=${seed} seed=2"),
        ("+a=${b} +b=${seed} seed=1", "+a=${b} +b=${seed} seed=2"),  # through another
        ("excitation.axes=[surge] excitation=prbs", "excitation.axes=[sway] excitation=prbs"),
        ("vessel.dofs=[surge] excitation=prbs", "vessel.dofs=[sway,yaw] excitation=prbs"),
        (f"{NAMED} seed=1", f"{NAMED} seed=2"),
        ("plant.change={at_s:1,scale:2} seed=1", "plant.change={scale:3} seed=1"),
        ("~update seed=1", "~update seed=2"),
        ("+new.x=1 seed=1", "+new.x=2 seed=2"),
        ("seed=1", "seed='1'"),
        ("seed=1", "seed=true"),
        ("seed=0.0", "seed=-0.0"),
        ("controller.kp=[1,2] controller={kp:[4]}", "controller.kp=[1,2] controller={kp:[5]}"),
        ("plant.scale=1 +plant.scale=2", "plant.scale=null +plant.scale=2"),
        ("seed=1 absent=2", "seed=2 absent=2"),
        ("seed=1", "seed=???"),
        ("controller.kp=[1,2,3]", "controller.kp=4"),
        ("seed=${.sample_time_s}", "seed=${.plant.scale}"),  # in Hydra's part they lead nowhere
        (f"{OWN} controller.ki=${{vessel.tuning.pid.kp}}", OWN),  # read by one option less
        ("vessel.tuning.reference.interval_s=1", "vessel.tuning.reference.interval_s=true"),
        ("vessel.tuning.pid.kp=null seed=1", "vessel.tuning.pid.kp=null seed=2"),  # derived
        ("~vessel.tuning vessel.length_m=5", "~vessel.tuning vessel.length_m=6"),
        ("controller.kp=auto", "controller.kp=[1,2,3]"),
        ("~vessel.tuning sample_time_s=0.1", "~vessel.tuning sample_time_s=0.2"),
        ("vessel.inertia.0.0=2e3 seed=1", "vessel.inertia.0.0=2.5e3 seed=2"),  # in a list
        ("vessel.inertia.0=[1,0,0]", "vessel.inertia.0.1=3"),
        ("+new=${vessel.dofs.0} vessel.dofs.0=a", "+new=${vessel.dofs.0} vessel.dofs.0=b"),
        ("+new=${vessel.dofs[0]} vessel.dofs.0=a", "+new=${vessel.dofs[0]} vessel.dofs.0=b"),
        ("vessel.inertia.3.0=1", "vessel.inertia.3.0=2"),  # there is no such row
        ("~vessel.dofs.2 seed=1", "~vessel.dofs.2 seed=2"),
        ("vessel.dofs.0=1 vessel.dofs=[a]", "vessel.dofs.0=2 vessel.dofs=[b]"),
    ],
)
def test_a_job_after_another(master: DictConfig, first: str, second: str) -> None:
    composer = Composer(SharingLoader(loader()), master)
    for job in (first.split(), second.split(), first.split()):
        assert shared(composer, job) == by_hydra(master, job), job


def test_later_jobs_do_not_change_earlier_ones(master: DictConfig) -> None:
    composer = Composer(SharingLoader(loader()), master)
    orders = [composer.order([f"vessel.plant_scale={scale}"]) for scale in (2, 3, 4)]
    assert [order.config["plant"]["scale"] for order in orders] == [2, 3, 4]
    assert [order.config["vessel"]["plant_scale"] for order in orders] == [2, 3, 4]


@pytest.mark.parametrize(
    ("argument", "count"),
    [
        ("seed=range(0,3)", 3),
        ("plant.scale=range(0.5,2,0.25)", 6),
        ("identifier=glob(l*)", 3),
        ("controller.kp=choice([1,2],[3,4])", 2),
        ("+new=sort(3,1,2)", 3),
        ("identifier=ls,nothing", 2),
    ],
)
def test_what_a_sweep_lists(master: DictConfig, argument: str, count: int) -> None:
    composer = Composer(SharingLoader(loader()), master)
    parser = OverridesParser.create(config_loader=loader())
    jobs = jobs_of(parser, {}, [], [argument, "sample_time_s=0.1,0.2"], Limits())
    assert len(jobs) == 2 * count
    for job in jobs:
        assert shared(composer, job) == by_hydra(master, job), job


@given(
    st.from_regex(r"[+~]{0,2}[a-z_.0-9]{1,4}=[-+]?[0-9_.e+-]{0,22}", fullmatch=True)
    | st.builds("seed={}".format, st.integers() | st.floats())
)
def test_numbers_are_read_as_hydra_reads_them(text: str) -> None:
    def parsed(parse: Any) -> str:
        try:
            (override,) = parse([text])
        except EXPECTED as error:
            return f"{type(error).__name__}: {error}"
        value = override.value()
        return repr((vars(override) | {"config_loader": None}, type(value), value))

    ours, hydras = Parser(None), OverridesParser.create()  # type: ignore[arg-type]
    assert parsed(ours.parse) == parsed(hydras.parse_overrides)
