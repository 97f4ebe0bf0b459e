"""Logbooks with known numbers in them, written as the runner writes them."""

import re
from collections.abc import Mapping, Sequence
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.compare.benchmark import cells, task_of
from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.tables import RunRow
from seatrial.runner.record.rows import Coefficient, Metric, Results, Series
from seatrial.runner.record.vocabulary import GROUPS
from tests.runner.database.samples import make_start

VESSEL = {"dofs": ["surge", "sway", "yaw"], "force_limits": [100.0, 100.0, 500.0]}
UNITS = {  # of a column by its name: the first that matches
    r"t": "s",
    r"wind_(north|east)|u|v|(surge|sway).*": "m/s",
    r"(tau|wind|residual)_.*yaw": "Nm",
    r"(tau|wind|residual)_.*": "N",
    r"(e_)?psi.*|delta.*": "rad",
    r"(e_pos|x|y|clearance).*": "m",
    r".*": "",
}


def logbook_at(folder: Path) -> LogbookWriter:
    return LogbookWriter.open(f"sqlite:///{folder}/results.db", results_dir=folder)


def start(
    identifier: str = "ls", disturbance: str = "calm", seed: int = 0, **changes: Any
) -> RunRow:
    """A run's start; its fingerprint says all that is given here."""
    config = {
        "identifier": {"_target_": f"models.{identifier}", "force": "filtered"},
        "plant": {"scale": 0.5}, "lap": True, "lowpass_hz": None, **changes.pop("config", {}),
    }  # fmt: skip
    overrides = changes.pop("overrides", [f"identifier={identifier}", f"seed={seed}"])
    told = f"{identifier} {disturbance} {sorted(changes.items())} {sorted(config.items())}"
    return make_start(
        seed,
        fingerprint=sha256(f"{told} {seed}".encode()).hexdigest(),
        experiment=sha256(told.encode()).hexdigest(),
        identifier=identifier,
        disturbance=disturbance,
        config=config | {"seed": seed},
        overrides=overrides,
        git_commit="0123456789abcdef",
        git_dirty=True,
        **changes,
    )


def planned(begins: Sequence[RunRow]) -> list[dict[str, Any]]:
    """The rows of trials that a sweep plans."""
    return [
        {
            "fingerprint": begin.fingerprint, "overrides": begin.overrides, "seed": begin.seed,
            "choices": {name: getattr(begin, name) for name in GROUPS},
        }
        for begin in begins
    ]  # fmt: skip


def force_mse(value: float | None, dof: str = "surge", model: str = "identified") -> Metric:
    unit = "(Nm)^2" if dof == "yaw" else "N^2"
    return Metric("validation", model, dof, "force_mse", value, unit)


def below(value: float, dof: str = "surge") -> Metric:
    return Metric("validation", "identified", dof, "below_true_model", value, "")


def tracking(value: float, model: str = "identified") -> Metric:
    return Metric("deployment", model, "position", "e_pos_mae", value, "m")


def deployed(name: str, value: float, model: str = "identified", dof: str = "all") -> Metric:
    return Metric("deployment", model, dof, name, value, "")


def coefficient(
    term: str, value: float, error: float | None, truth: float | None, dof: str = "surge",
    unit: str = "kg",
) -> Coefficient:  # fmt: skip
    return Coefficient("identified", dof, term, value, error, truth, unit)


def series(kind: str, columns: Mapping[str, Any]) -> Series:
    """Columns with the units of their names."""
    units = {
        name: next(unit for pattern, unit in UNITS.items() if re.fullmatch(pattern, name))
        for name in columns
    }
    return Series(kind, columns, units)


def finish(
    logbook: LogbookWriter,
    begin: RunRow,
    *results: Any,
    sweep: int | None = None,
    rerun: bool = False,
    **more: Any,
) -> int:
    """Store a run with `Results(*results, **more)`; returns its number."""
    begun = logbook.begin_run(begin, sweep, rerun=rerun)
    assert begun.state == "new"
    logbook.finish_run(begun.run_id, Results(*results, **more))
    return begun.run_id


def fail(
    logbook: LogbookWriter, begin: RunRow, status: Any = "failed", error: str = "broken",
    sweep: int | None = None,
) -> int:  # fmt: skip
    begun = logbook.begin_run(begin, sweep)
    assert begun.state == "new"
    logbook.fail_run(begun.run_id, status, "ValueError", error, "Traceback: here\nValueError")
    return begun.run_id


def interval(of_estimate: bool) -> Diagnostic:
    return Diagnostic("interval_of_estimate", "all", float(of_estimate))


def fill_plain(logbook: LogbookWriter) -> None:
    """What `conftest.plain` describes."""
    calm = {"none": (100.0, 102.0, 104.0), "ls": (50.0, 51.0, 55.0), "plsr": (40.0, 41.0, 42.0)}
    for identifier, values in calm.items():
        for seed, value in enumerate(values):
            metrics = [force_mse(value), force_mse(2.0 * value, "yaw"), tracking(value / 100.0)]
            metrics += [tracking(1.0, "nominal"), below(float(identifier == "plsr"))]
            found = [
                coefficient("u_dot", 1000.0 + value, 3.0, 1050.0),
                coefficient("u", 60.0, 4.0, None, unit="kg/s"),
            ]
            finish(logbook, start(identifier, "calm", seed), metrics, found)
    for seed, value in enumerate((200.0, 210.0, 220.0)):
        finish(logbook, start("none", "noise", seed), [force_mse(value)])
    finish(logbook, start("ls", "noise", 0), [force_mse(90.0)])
    fail(logbook, start("ls", "noise", 1), "failed", "singular matrix\nin the middle")
    fail(logbook, start("ls", "noise", 2), "diverged", "|r| = 9 rad/s exceeds 3 at t = 12 s")
    finish(logbook, start("plsr", "noise", 0), [force_mse(80.0)])
    finish(logbook, start("plsr", "noise", 1), [force_mse(float("nan"))])


def fill_sailed(logbook: LogbookWriter) -> None:
    """Nine runs of a sweep, with everything that a figure can show."""
    sweep = logbook.begin_sweep("sailed", "seatrial -m", [], 9)
    for seed, identifier in product(range(2), ("ls", "plsr")):
        finish(
            logbook,
            start(identifier, "constant", seed, config={"vessel": VESSEL}),
            [force_mse(400.0 + seed, dof) for dof in ("surge", "sway", "yaw")],
            _coefficients(seed),
            [*(_orders(seed) if identifier == "plsr" else []), *_excitation()],
            [_recording(), _residual(), _voyage("nominal", 0.5), _voyage("identified", 0.1)],
            sweep=sweep,
        )
    truth = [coefficient("u_dot", 1200.0, None, 1200.0), coefficient("u", 10.0, None, 10.0)]
    turn = {"vessel": {"length_m": 10.0}, "excitation": {"manoeuvre": "turn", "helm": "delta"}}
    diameter = Metric("validation", "identified", "all", "manoeuvre_tactical_diameter", 6.1, "L")
    for begin, results in (
        (start("nsga2"), Results(coefficients=truth, diagnostics=_pareto())),
        (start("surface"), Results(diagnostics=_surface())),
        (start("dsr"), Results(diagnostics=_spectrum(), series=[_recording()])),
        (start("iv"), Results(diagnostics=_mix(), series=[_prediction(), *_planned()])),
        (start("none", config=turn), Results([diameter], series=[circle()])),
    ):
        logbook.finish_run(logbook.begin_run(begin, sweep).run_id, results)


def _excitation() -> list[Diagnostic]:
    """Of surge one pair of terms cannot be told apart."""
    surge = {"regressor_rank": 2.0, "regressor_unknowns": 3.0, "spectral_lines": 1.0}
    yaw = surge | {"regressor_unknowns": 2.0}
    return [
        *(Diagnostic(name, "surge", value) for name, value in surge.items()),
        *(Diagnostic(name, "yaw", value) for name, value in yaw.items()),
        Diagnostic("inseparable_terms", "surge", 2.0, i=0, label="u |u|u"),
    ]


def circle(radius_m: float = 30.0, speed_m_s: float = 2.0) -> Series:
    """Northward for 10 s, then two circles to starboard under a helm of 35 degrees, no drift."""
    t = np.arange(0.0, 10.0 + 4.0 * np.pi * radius_m / speed_m_s, 0.1)
    psi = np.maximum(t - 10.0, 0.0) * speed_m_s / radius_m
    ahead = speed_m_s * np.minimum(t, 10.0)
    columns = {"t": t, "x": ahead + radius_m * np.sin(psi), "y": radius_m * (1.0 - np.cos(psi))}
    columns |= {"psi": psi, "u": np.full_like(t, speed_m_s), "v": np.zeros_like(t)}
    columns |= {"delta": np.radians(35.0) * (t > 9.95), "tau_surge": np.full_like(t, 90.0)}
    return series("recording", columns)


def _recording() -> Series:
    """A sine of 90 N over 20 s against a limit of 100 N, and a wind of 10 m/s that blows to 350."""
    t = np.arange(0.0, 200.0, 0.5)
    columns = {"t": t, "train": (t < 50.0).astype(float)}
    columns |= {"x": t, "y": np.zeros_like(t), "psi": np.zeros_like(t)}
    columns |= {"tau_surge": 90.0 * np.sin(2.0 * np.pi * t / 20.0), "tau_sway": np.zeros_like(t)}
    columns |= {"tau_yaw": 5.0 * np.sin(2.0 * np.pi * t / 10.0)}
    columns |= {"tau_actual_surge": 0.5 * columns["tau_surge"]}
    angle = np.radians(np.full_like(t, 350.0) + 20.0 * np.sin(t))
    columns |= {"wind_north": 10.0 * np.cos(angle), "wind_east": 10.0 * np.sin(angle)}
    columns |= {"wind_surge": np.full_like(t, 30.0), "wind_yaw": np.full_like(t, -4.0)}
    return series("recording", columns)


def _coefficients(seed: int) -> list[Coefficient]:
    return [
        coefficient("u_dot", 1195.0 + 5.0 * seed, 8.0, 1195.0),
        coefficient("u", 15.0 - seed, 3.0, 13.8, unit="kg/s"),
        coefficient("|u|u", 9000.0, 30.0, 55.0, unit="kg/m"),
        coefficient("u^3", 0.1, 0.1, 0.0, unit="kg s/m^2"),
        coefficient("v_dot", 1260.0, 4.0, None, "sway"),
    ]


def _orders(seed: int) -> list[Diagnostic]:
    found = []
    for dof, unit in (("surge", "N^2"), ("yaw", "(Nm)^2")):
        for order in range(1, 9):
            value = 3000.0 / order + 10.0 * (order - 4) ** 2 + seed
            found.append(Diagnostic("order_mse", dof, value, unit, i=order, label="blocked"))
        found.append(Diagnostic("selected_order", dof, 4.0 + seed, label="blocked"))
    return found


def _residual() -> Series:
    t = np.arange(0.0, 100.0, 0.5)
    columns = {"t": t, "train": (t < 50.0).astype(float)}
    for dof, (model, size) in product(("surge", "yaw"), (("nominal", 60.0), ("identified", 20.0))):
        columns[f"residual_{model}_{dof}"] = size * np.sin(t / 5.0)
    return series("residual", columns)


def _prediction() -> Series:
    """Two pieces with a band; the nominal model diverges in the second one."""
    t = np.arange(0.0, 100.0, 0.5)
    u, start = np.sin(0.1 * t), np.where(t % 50.0 == 0.0, 1.0, 0.0)
    columns = {"t": t, "start": start, "surge": u, "surge_identified": 0.9 * u}
    columns["surge_identified_std"] = np.full(len(t), 0.1)
    columns["surge_nominal"] = np.where(t < 80.0, 1.3 * u, np.nan)
    columns |= {"x": t, "x_identified": 1.1 * t, "x_identified_std": 0.1 * t}
    return series("prediction", columns)


def _voyage(model: str, error: float) -> Series:
    t = np.arange(0.0, 200.0, 0.5)
    psi = 2.0 * np.pi * t / 200.0
    columns = {"t": t, "psi": psi, "x_d": 20.0 * np.sin(psi), "y_d": 30.0 - 30.0 * np.cos(psi)}
    columns |= {"x": (20.0 + error) * np.sin(psi), "y": 30.0 - (30.0 + error) * np.cos(psi)}
    columns |= {"e_pos": np.full_like(t, error), "e_psi": 0.1 * error * np.cos(psi)}
    columns |= {"wind_north": np.where(t < 100.0, 0.0, -8.0)}
    columns |= {"wind_east": np.where(t < 100.0, 4.0, 0.0)}
    columns |= {f"{name}_setpoint": columns[f"{name}_d"] for name in ("x", "y")}
    columns |= {"tau_surge": 50.0 * np.cos(psi), "tau_sway": np.full_like(t, 1e3 * error)}
    columns |= {"wind_surge": np.full_like(t, -30.0), "wind_sway": np.full_like(t, 40.0)}
    return series(f"deployment_{model}", columns)


def _pareto() -> list[Diagnostic]:
    found = [Diagnostic("pareto_chosen", "all", 1.0, i=7)]
    for i, share in enumerate(np.arange(20) / 20.0):
        for j, (way, what, unit) in enumerate(
            ((1.0 - share, "position", "m"), (share, "velocity", "m/s"))
        ):
            value, label = 0.1 + way**2, f"{what} MAE"
            found.append(Diagnostic("pareto_objective", "all", value, unit, i=i, j=j, label=label))
    return found


def _surface() -> list[Diagnostic]:
    chosen = {"selected_order": 3.0, "selected_variables": 6.0}
    errors = {
        (i, j): 100.0 + 1e4 / i + 50.0 * (j - 6) ** 2 for i in range(1, 9) for j in range(i, 9)
    }
    return [
        *(Diagnostic(name, "surge", value) for name, value in chosen.items()),
        *(Diagnostic("surface_mse", "surge", v, "N^2", i=i, j=j) for (i, j), v in errors.items()),
    ]


def _mix() -> list[Diagnostic]:
    """Two manoeuvres that are sailed, one that is not, and how the plan was kept to."""
    counts = {"zigzag_10": 2.0, "circle": 0.0, "multisine": 1.0}
    kept = {"plan_deviation": 0.25, "sailed_clearance": 1.5}
    return [
        *(
            Diagnostic("mix_count", "all", n, i=i, label=k)
            for i, (k, n) in enumerate(counts.items())
        ),
        *(Diagnostic(name, "all", value, "m") for name, value in kept.items()),
    ]


def _planned() -> list[Series]:
    """A path of two zig-zags, a multisine that is held out, passages; obstacles; as sailed."""
    t = np.arange(0.0, 80.0, 1.0)
    what = np.repeat([-1.0, 0.0, -1.0, 2.0, 0.0, -1.0, -1.0, -1.0], 10)
    path = {"t": t, "x": 5.0 + 0.4 * t, "y": 5.0 + 3.0 * np.sin(t / 9.0), "psi": 0.02 * t}
    role = np.where(what == 2.0, 2.0, np.where(what == 0.0, 1.0, 0.0))
    corners = np.array([[0, 0, -5], [0, 45, -5], [0, 45, 25], [0, 0, 25], [1, 10, 12], [1, 20, 12],
                        [1, 20, 20], [2, 30, -2], [2, 35, -2], [2, 35, 1]])  # fmt: skip
    waters = dict(zip(("polygon", "x", "y"), 1.0 * corners.T, strict=True))
    return [
        series("plan", path | {"manoeuvre": what, "role": role}),
        series("waters", waters | {"clearance": np.full(len(corners), 1.0)}),
        series("recording", path | {"tau_surge": np.sin(t)}),
    ]


def _spectrum() -> list[Diagnostic]:
    found = [Diagnostic("selected_order", "all", 3.0)]
    for k in range(1, 9):
        value = float(np.exp(-k)) if k <= 3 else 0.01 / k
        found.append(Diagnostic("singular_value", "all", value, i=k))
    return found


def fill_benchmark(logbook: LogbookWriter) -> None:
    """Free runs of three entrants in the first weather of the task ferry_simulated."""
    task, rng = task_of("ferry_simulated"), np.random.default_rng(0)
    sweep = logbook.begin_sweep("benchmark_ferry_simulated", "seatrial benchmark", [], 3)
    for error, name in enumerate(("ls", "auto", "none")):
        cell = next(cells(task, [name]))
        columns = {"t": 0.1 * np.arange(200), "start": 1.0 * (np.arange(200) == 0)}
        for dof, motion in zip(task.outputs, rng.standard_normal((200, 3)).T, strict=True):
            columns |= {dof: motion, f"{dof}_identified": motion + 0.1 * (error + 1)}
        predicted = [series("prediction", columns)]
        finish(logbook, start(name, overrides=cell.options), series=predicted, sweep=sweep)
    logbook.end_sweep(sweep)
