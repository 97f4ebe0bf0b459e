"""Stored runs as pandas frames, tables and figures: what the shell shows, as objects."""

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import seatrial as st
from seatrial.runner.compare.__main__ import run as results_program


def test_a_run_is_its_rows(run: st.Run) -> None:
    metrics = run.metrics
    assert list(metrics.columns) == ["stage", "model", "dof", "name", "value", "unit"]
    (direct,) = metrics.query("name == 'e_pos_mae' and model == 'identified'")["value"]
    assert run.metric("e_pos_mae", "position") == direct
    assert set(run.coefficients["model"]) >= {"nominal", "identified", "plant"}
    assert run.config["seed"] == 3
    with pytest.raises(
        st.ConfigurationError, match="got 0 numbers e_pos_mae with dof all of model"
    ):
        run.metric("e_pos_mae")
    with pytest.raises(st.ConfigurationError, match=r"no such metric\. did you mean e_pos_m"):
        run.metric("e_pos")


def test_a_tracking_error_is_the_mean_of_its_series(run: st.Run) -> None:
    series = run.series("deployment_identified")
    assert series.index.name == "t"
    assert series.attrs["units"]["e_pos"] == "m"
    assert np.mean(series["e_pos"]) == pytest.approx(run.metric("e_pos_mae", "position"))
    distance = np.hypot(series["x"] - series["x_d"], series["y"] - series["y_d"])
    np.testing.assert_allclose(series["e_pos"], distance)


def test_the_table_is_that_of_the_shell(
    sweep: st.Logbook, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = {"metric": "force_mse", "stage": "validation", "dof": ["surge", "yaw"]}
    table = sweep.table(**options, rows="identifier,dof", baseline="identifier=none", digits=None)
    words = "table --metric force_mse --stage validation --dof surge,yaw --rows identifier,dof"
    words += f" --baseline identifier=none --sweep {sweep.number}"
    for form in ("json", "md", "latex"):
        assert results_program([*words.split(), "--format", form]) == 0
        assert capsys.readouterr().out.rstrip("\n") == table.text(form)
    with pytest.raises(ValueError, match="'pdf' is not a valid OutputFormat"):
        table.text("pdf")
    records = json.loads(table.text("json"))
    assert len(records) == 4
    assert list(table.frame.columns) == list(records[0])
    assert list(table.frame["mean"]) == [record["mean"] for record in records]
    mean = sweep.to_pandas("force_mse").query(
        "identifier == 'ls' and dof == 'surge' and model == 'identified'"
    )["value"].mean()  # fmt: skip
    row = table.frame.query("identifier == 'ls' and dof == 'surge'")
    assert row["mean"].item() == pytest.approx(mean)


def test_the_figure_is_that_of_the_shell(
    run: st.Run, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert results_program(["plot", "track", "--run", "1", "--output", "figures"]) == 0
    png, svg = map(Path, capsys.readouterr().out.split())
    figure = run.plot("track")
    for file, clean in ((png, {"Software": None}), (svg, {"Date": None})):
        own = io.BytesIO()
        figure.savefig(own, format=file.suffix[1:], metadata=clean)
        assert own.getvalue() == file.read_bytes()
    shown = vars(type(figure))["_repr_png_"](figure)  # what a notebook asks for
    assert shown.startswith(b"\x89PNG")


def test_figures_take_axes(sweep: st.Logbook, run: st.Run) -> None:
    axes = Figure().subplots()
    assert sweep.plot("bars", metric="force_mse", dof="surge", ax=axes) is axes.figure
    means = sweep.to_pandas("force_mse").query("dof == 'surge' and model == 'identified'")
    expected = means.groupby("identifier")["value"].mean()
    assert [bar.get_height() for bar in axes.patches] == pytest.approx(
        [expected["none"], expected["ls"]]
    )
    with pytest.raises(st.ConfigurationError, match="several panels"):
        run.plot("errors", ax=axes)
    with pytest.raises(st.ConfigurationError, match="got 2 figures, expected one"):
        sweep.plot("residual", facet="seed")
    with pytest.raises(st.ConfigurationError, match="plot: got 'pie', expected one of bars"):
        sweep.plot("pie")
    with pytest.raises(st.ConfigurationError, match="table: no option 'metrics', did you mean met"):
        sweep.table(metrics="force_mse")


def test_a_sweep_selects_its_own_runs(sweep: st.Logbook, here: Path) -> None:
    frame = sweep.runs()
    assert sorted(zip(frame["identifier"], frame["seed"], strict=True)) == [
        ("ls", 0), ("ls", 1), ("none", 0), ("none", 1),
    ]  # fmt: skip
    assert set(sweep.to_pandas()["run_id"]) == set(frame.index)
    with pytest.raises(st.ConfigurationError, match=r"names: no metric 'force_ms', did"):
        sweep.to_pandas("force_ms")
    models = sweep.to_pandas("force_mse").groupby("identifier")["model"].unique()
    assert {"identified"} == {"nominal", "identified"} & set(models["none"])
    assert {"nominal", "identified"} <= set(models["ls"])
    everything = st.open("results/results.db")
    chosen = everything.table(metric="force_mse", dof="surge", sweep=sweep.number)
    assert str(chosen) == str(sweep.table(metric="force_mse", dof="surge"))
    assert set(everything.runs().index) == {1, *frame.index}
    assert set(everything.to_pandas("force_mse")["run_id"]) == {1, *frame.index}
    assert list(everything.runs(where="seed=3").index) == [1]
    with pytest.raises(st.LogbookError, match="there is no run 77"):
        everything.run(77)


def test_a_logbook_is_found_from_another_folder(
    sweep: st.Logbook, here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logbook = st.open("results/results.db")
    monkeypatch.chdir(tmp_path)
    assert len(logbook.runs(sweep=sweep.number)) == len(sweep.runs()) == 4
    assert re.search(r"identifier +controller", repr(sweep))
