"""Trials and sweeps from Python: the command line's own results, and nothing left behind."""

import logging
import os
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import Any, cast

import pandas as pd
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins

import seatrial as st
from seatrial.runner.configuration.hydra_errors import CONF
from tests.runner.command import Command
from tests.runner.programs import rows

CHEAP = {"vessel": "surge_linear", "excitation": "prbs", "controller": "none", "identifier": "ls"}
OPTIONS = [f"{name}={value}" for name, value in CHEAP.items()]


NUMBERS = "SELECT run_id, stage, model, dof, name, value FROM metric ORDER BY id"


def test_the_command_line_and_python_store_the_same(seatrial: Command, tmp_path: Path) -> None:
    run = st.run(**CHEAP, seed=2)
    assert (run.number, run.status) == (1, "finished")
    own = rows(tmp_path, NUMBERS)
    assert len(own) > 50
    answer = seatrial(*OPTIONS, "seed=2")
    assert "already in the logbook as run 1" in answer.out
    seatrial.succeeds(*OPTIONS, "seed=2", "results_dir=shell/results")
    assert rows(tmp_path / "shell", NUMBERS) == own


def test_a_dry_run_is_for_the_command_line(seatrial: Command) -> None:
    fake = seatrial.pretend()
    with pytest.raises(st.ConfigurationError, match="dry_run: the command line lists trials"):
        st.run(seed=5, dry_run=True)
    with pytest.raises(st.ConfigurationError, match="dry_run: the command line lists trials"):
        st.sweep(["seed=5,6", "dry_run=true"])
    assert fake.ran == []


def test_the_command_of_a_run_repeats_it(seatrial: Command) -> None:
    fake = seatrial.pretend()
    basis = ["u_dot", "u"]
    run = st.run(
        seed=5, vessel="supply_vessel", identifier="ls", identifier__basis=basis, database="a b.db"
    )
    words = run.command.removeprefix("python -m runner ")
    assert words != run.command
    seatrial.succeeds(*shlex.split(words))
    assert fake.ran == [5, 5]
    assert list(run.logbook.runs().index) == [2, 1]
    (started,) = pd.read_sql("SELECT command FROM run WHERE id = 1", run.logbook.address)["command"]
    assert started.startswith("python -m runner ")
    assert "'identifier.basis=[u_dot,u]'" in started


def test_nothing_of_hydra_is_left_behind(
    seatrial: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seatrial.pretend()
    plugins, path = dict(Plugins.instance().class_name_to_class), list(sys.path)
    handlers, level = logging.getLogger().handlers[:], logging.getLogger().level
    config, environment = HydraConfig.instance().cfg, dict(os.environ)
    st.run(seed=1)
    st.sweep(["seed=1,2"], progress=False)
    with pytest.raises(st.ConfigurationError):
        st.run(seed="one")
    assert not GlobalHydra.instance().is_initialized()
    assert HydraConfig.instance().cfg is config
    assert Plugins.instance().class_name_to_class == plugins
    assert (sys.path, Path.cwd()) == (path, tmp_path)
    assert (logging.getLogger().handlers, logging.getLogger().level) == (handlers, level)
    seatrial("-m", "seed=1,2")
    assert dict(os.environ) == environment


def test_a_program_with_a_hydra_of_its_own_keeps_it(seatrial: Command) -> None:
    seatrial.pretend()
    with initialize_config_dir(str(CONF), job_name="mine", version_base="1.3"):
        mine = GlobalHydra.instance().hydra
        st.run(seed=1)
        assert GlobalHydra.instance().hydra is mine
        assert compose("trial", overrides=["hydra/sweeper=basic", "seed=4"]).seed == 4


def test_errors_are_the_line_of_the_command(seatrial: Command) -> None:
    for options, words in (
        ({"identifier": "lss"}, ["identifier=lss"]),
        ({"identifier": {"bases": "full"}}, ["identifier.bases=full"]),
        ({"excitation": "recording", "excitation__path": "none.csv"},
         ["excitation=recording", "excitation.path=none.csv"]),
        ({"limits__samples": 10}, ["limits.samples=10"]),
    ):  # fmt: skip
        line = seatrial.refuses(*words)
        with pytest.raises(st.SeatrialError) as caught:
            st.run(**options)  # type: ignore[arg-type]
        assert str(caught.value) == line
        assert caught.value.__suppress_context__ or caught.value.__context__ is None
    with pytest.raises(st.ConfigurationError, match="overrides: got 3, expected text such as"):
        st.run(3)
    with pytest.raises(st.SeatrialError) as caught:
        st.sweep([options], progress=False)
    assert line in str(caught.value)
    assert list(seatrial.folder.iterdir()) == []


def test_a_failed_trial_raises_and_is_stored(seatrial: Command) -> None:
    fake = seatrial.pretend()
    fake.failing, fake.diverging = {1}, {2}
    with pytest.raises(st.RunFailed, match="run 1 failed: ZeroDivisionError: seed 1 ran aground"):
        st.run(seed=1)
    failed = st.open().run(1)
    with pytest.raises(st.ConfigurationError, match="has no such metric"):
        failed.metric("force_mse", "surge")
    assert "run 1, failed: milliampere" in repr(failed)
    with pytest.raises(st.RunFailed, match=r"run 2 diverged: Diverged: \|r\| = 11") as caught:
        st.run(seed=2)
    assert caught.value.run.status == "diverged"
    assert caught.value.run.metric("force_mse", "surge") == 2.0  # what is valid is stored
    sweep = st.sweep(["seed=0,1,2"], progress=False)
    assert dict(sweep.runs()["status"].value_counts()) == {
        "finished": 1, "failed": 1, "diverged": 1,
    }  # fmt: skip


def test_an_interrupted_call_may_be_repeated(seatrial: Command) -> None:
    fake = seatrial.pretend()
    fake.interrupted = {1}
    with pytest.raises(KeyboardInterrupt):
        st.run(seed=1)
    with pytest.raises(KeyboardInterrupt):
        st.sweep(["seed=0,1,2"], progress=False)
    assert not GlobalHydra.instance().is_initialized()
    fake.interrupted = set()
    sweep = st.sweep(["seed=0,1,2"], progress=False)
    assert fake.ran == [1, 0, 1, 1, 2]
    assert list(sweep.runs("status=finished").index) == [5, 4, 2]


def test_a_mapping_is_a_variant_and_a_list_of_texts_a_grid(seatrial: Command) -> None:
    seatrial.pretend()
    variants = [{"identifier": "ls", "seed": 1}, {"identifier": "none", "seed": 2}]
    sweep = st.sweep(variants, name="two", progress=False)
    frame = sweep.runs()
    assert sorted(zip(frame["identifier"], frame["seed"], strict=True)) == [("ls", 1), ("none", 2)]
    assert set(frame["sweep"]) == {"two"}
    grid = st.sweep(
        ["identifier=ls,none"], seed=range(3), disturbance=["wind", "noise"], progress=False
    )
    assert len(grid.runs()) == 6
    assert set(grid.runs()["disturbance"]) == {"wind+noise"}
    assert len(st.open().runs()) == 8  # all of them


def test_a_sweep_is_not_one_trial(seatrial: Command) -> None:
    with pytest.raises(st.ConfigurationError, match="experiment=jervan_table_4_10: got a sweep"):
        st.run(experiment="jervan_table_4_10")
    with pytest.raises(st.ConfigurationError, match="Sweep parameters"):
        st.run(seed=range(3))
    for wrong in (3, [3]):
        with pytest.raises(st.ConfigurationError, match="trials: got 3, expected overrides or"):
            st.sweep(cast(Any, wrong))


def test_a_database_has_a_place(seatrial: Command, tmp_path: Path) -> None:
    run = st.run(**CHEAP, database=tmp_path / "deep" / "ship.db")
    files = {path.relative_to(tmp_path).parts[0] for path in tmp_path.rglob("*")}
    assert files == {"deep"}
    assert len(run.series()) > 100
    assert len(st.open(tmp_path / "deep" / "ship.db").runs()) == 1
    with pytest.raises(st.LogbookError, match=r"results.db"):
        st.open()
    wrong = cast(Any, 3)
    for call in (partial(st.run, database=wrong), partial(st.sweep, [], database=wrong)):
        with pytest.raises(st.ConfigurationError, match="database: got 3, expected a file"):
            call()
    with pytest.raises(st.ConfigurationError, match="database: got 3, expected a file"):
        st.open(wrong)
