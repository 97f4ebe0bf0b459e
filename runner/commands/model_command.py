"""`seatrial model LOG`: from a boat's log to a model that sails, in one command."""

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.notation import PLANAR, VELOCITY_UNIT
from seatrial.models.vessel import scales
from seatrial.models.vessel.basis import INPUTS, Array
from seatrial.runner import export
from seatrial.runner.commands import init
from seatrial.runner.commands.data_commands import File, Force, MapFile, VesselName, map_columns
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.frame import open_results
from seatrial.runner.configuration.named_files import read_map, reader_of
from seatrial.runner.sweeps import in_process

METRIC = "velocity_rmse_restarts"
Length = Annotated[float | None, typer.Option("--length", help="[m] between perpendiculars.")]
Mass = Annotated[float | None, typer.Option("--mass", help="[kg] displacement.")]
Database = Annotated[Path, typer.Option("--results-dir", help="Where the run is stored.")]
app = typer.Typer(name="seatrial model", add_completion=False, pretty_exceptions_enable=False)
main = partial(run_typer, app)  # of the words that follow `seatrial model`


@app.command()
def model(
    log: File, length: Length = None, mass: Mass = None, vessel: VesselName = None,
    map_file: MapFile = None, force: Force = False, results_dir: Database = Path("results"),
) -> None:  # fmt: skip
    """Identify a model from a log: map, check, a drafted vessel, `identifier=auto`, a vessel file.

    The run is stored as any other. seatrial-results model RUN writes the model of a stored run,
    also for other programs.
    """
    name = re.sub(r"^(?![A-Za-z])", "log_", re.sub(r"\W", "_", log.stem, flags=re.ASCII))
    output = Path(f"{name}_model.yaml")
    if output.exists() and not force:
        raise ConfigurationError(f"{output}: exists already, expected a new name or --force")
    if vessel is None and length is None:
        raise ConfigurationError("model: expected --length of the boat [m], or --vessel NAME")
    if map_file is None:
        map_file = Path(f"{name}.map.yaml")
        if questions := map_columns(log, vessel, map_file, force):
            more = f"; {len(questions) - 1} more in it" if questions[1:] else ""
            raise ConfigurationError(
                f"{questions[0]} (answer it in {map_file}, and go on with --map {map_file}{more})"
            )
    reader = reader_of(log, read_map(map_file))
    columns = reader.columns
    foreign = [key for key in columns.inputs if vessel is None and key not in INPUTS]
    if foreign or not (columns.inputs or columns.force or columns.actual_force):
        raise ConfigurationError(
            f"{map_file}: got inputs {', '.join(columns.inputs) or 'none'}, expected force: "
            f"{{surge: COLUMN, ...}}, or inputs, some of {', '.join(INPUTS)}"
        )
    if vessel is None and length is not None:
        vessel = _drafted_vessel(name, length, mass, reader.account(PLANAR)[0].values, force)
    words = [
        f"vessel={vessel}", "excitation=recording", f"excitation.path={log}",
        f"excitation.map={map_file}", "controller=none", "evaluation=none",
        f"results_dir={results_dir}",
    ]  # fmt: skip
    call = in_process.run_trial(words)
    for line in call.lines:
        typer.echo(line)
    if call.outcome is None or call.outcome.run_id is None or call.exit_code:
        raise SeatrialError(str(call.error or "the trial stored nothing"))
    with open_results(str(results_dir / "results.db"), results_dir) as results:
        stored = export.stored_model.read_model(results.reader, call.outcome.run_id)
        _report(results.reader, call.outcome.run_id)
    for path in export.model_formats.write(stored, "yaml", output, None, force):
        typer.echo(f"wrote {path}; seatrial vessel={path} sails it")


def _drafted_vessel(
    name: str, length: float, mass: float | None, signals: Mapping[str, Array], force: bool
) -> str:
    """Write a vessel of some dimensions, with the inputs that the log holds; returns its path.

    The thrust of the shafts holds the mean speed. A rudder turns the way it did in the log, with
    the lift of the area of DNV, L T / 100 (1 + 50 (B / L)^2).
    """
    path = init.new_option("vessel", name)
    if path.exists() and not force:
        return path.as_posix()  # of a run before, and perhaps corrected since
    text = init.draft_vessel(name, {"length": length, "mass": mass})
    inputs = {key.partition(".")[2]: signals[key] for key in signals if key.startswith("inputs.")}
    hull, terms = scales.hull(length, mass_kg=mass), dict[str, float]()
    drag, shafts = scales.derivatives(hull), [n for n in inputs if n[0] in "np"]  # and pulses
    for key in shafts:
        u = float(np.nanmean(np.abs(signals["velocity.surge"])))
        square = float(np.nanmean(np.abs(inputs[key]) * inputs[key])) or 1.0
        terms[f"X_|{key}|{key}"] = -(drag["X_u"] + drag["X_|u|u"] * u) * u / square / len(shafts)
    if "delta" in inputs and "velocity.yaw" in signals:
        area = length * hull.draught_m / 100.0 * (1.0 + 50.0 * (hull.beam_m / length) ** 2)
        turning = float(np.sign(np.cov(inputs["delta"], signals["velocity.yaw"])[0, 1])) or 1.0
        lift = turning * 0.5 * scales.WATER * area * 2.5  # N over u^2 and rad, aspect ratio 1.5
        terms |= {"N_u^2delta": 0.5 * lift * length, "Y_u^2delta": -lift}
    lines = "".join(f"  {key}: {value:.6f}\n" for key, value in terms.items())
    ranges = {key: {"low": float(min(x.min(), 0.0)), "high": float(max(x.max(), 1e-6)),
                    "start": float(np.median(x))} for key, x in inputs.items()}  # fmt: skip
    text = text.replace("derivatives:\n", f"derivatives:\n{lines}", 1)
    text += yaml.safe_dump({"inputs": ranges}, sort_keys=False) if inputs else ""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    typer.echo(f"wrote {path}: a first guess from the dimensions")
    return path.as_posix()


def _report(reader: Any, run: int) -> None:
    """Print the errors of predicting the mean motion, which a useful model must beat."""
    rows = [row for row in reader.metrics(run) if row.name == METRIC and row.stage == "validation"]
    errors = {(row.dof, row.model): row.value for row in rows if row.value is not None}
    for (dof, model), error in errors.items():
        if model == "mean_motion":
            better = errors.get((dof, "identified"), np.inf) < error
            skill = "" if better else ": the model is no better than the mean motion"
            typer.echo(f"mean motion, {dof}: {error:.4g} {VELOCITY_UNIT[dof]}{skill}")
