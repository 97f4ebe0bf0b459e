"""`seatrial model LOG`: from a boat's log to a model that sails, in one command."""

from collections.abc import Mapping, Sequence
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
from seatrial.runner.commands.data_commands import Force, VesselName, map_columns
from seatrial.runner.commands.data_convert import File, MapFile
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.frame import open_results
from seatrial.runner.configuration.recording_map import read_map, reader_of
from seatrial.runner.sweeps import in_process

METRIC = "velocity_rmse_restarts"
Length = Annotated[float | None, typer.Option("--length", help="[m] between perpendiculars.")]
Mass = Annotated[float | None, typer.Option("--mass", help="[kg] displacement.")]
Database = Annotated[Path, typer.Option("--results-dir", help="Where the run is stored.")]
app = typer.Typer(name="seatrial model", add_completion=False, pretty_exceptions_enable=False)


def main(words: Sequence[str]) -> int:
    """Run `seatrial model` with the words that follow it; returns the exit code."""
    return run_typer(app, words)


@app.command()
def model(
    log: File, length: Length = None, mass: Mass = None, vessel: VesselName = None,
    map_file: MapFile = None, force: Force = False, results_dir: Database = Path("results"),
) -> None:  # fmt: skip
    """Identify a model from a log: map, check, a drafted vessel, `identifier=auto`, a vessel file.

    The run is stored as any other. seatrial-results model RUN writes the model of a stored run,
    also for other programs.
    """
    name = "".join(c if c.isalnum() and c.isascii() else "_" for c in log.stem) or "log"
    name = name if name[0].isalpha() else f"log_{name}"
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
    if not (columns.inputs or columns.force or columns.actual_force):
        raise ConfigurationError(
            f"{map_file}: got neither forces nor inputs, expected what moved the boat: "
            "force: {surge: COLUMN, ...}, or inputs: {delta: COLUMN, n: COLUMN}"
        )
    if unknown := [name for name in columns.inputs if vessel is None and name not in INPUTS]:
        raise ConfigurationError(
            f"{map_file}: inputs: got {unknown[0]!r}, expected some of {', '.join(INPUTS)}"
        )
    if vessel is None:
        assert length is not None
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
    """Write a vessel of some dimensions, with the inputs that the log holds; returns its path."""
    path = Path("conf", "vessel", f"{name}.yaml")
    if path.exists() and not force:
        return path.as_posix()  # of a run before, and perhaps corrected since
    (text,) = init.draft_vessel(name, {"length": length, "mass": mass}).files.values()
    inputs = {key.partition(".")[2]: signals[key] for key in signals if key.startswith("inputs.")}
    if inputs:
        terms, ranges = _input_terms(scales.hull(length, mass_kg=mass), inputs, signals)
        text = text.replace("derivatives:\n", f"derivatives:\n{terms}", 1) + ranges
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    typer.echo(f"wrote {path}: a first guess from the dimensions")
    return path.as_posix()


def _input_terms(
    hull: scales.Hull, inputs: Mapping[str, Array], signals: Mapping[str, Array]
) -> tuple[str, str]:
    """Terms of inputs, and their ranges: thrust that holds the mean speed, a rudder's lift.

    A rudder turns the way it did in the log; the area is that of DNV, L T / 100 (1 + 50 (B / L)^2).
    """
    drag = scales.derivatives(hull)
    u = float(np.nanmean(np.abs(signals["velocity.surge"])))
    resistance = -(drag["X_u"] + drag["X_|u|u"] * u) * u
    shafts = {key: x for key, x in inputs.items() if not key.startswith(("delta", "alpha"))}
    terms = {
        f"X_|{key}|{key}": resistance / (float(np.nanmean(np.abs(x) * x)) or 1.0) / len(shafts)
        for key, x in shafts.items()
    }
    if "delta" in inputs and "velocity.yaw" in signals:
        ratio = hull.beam_m / hull.length_m
        area = hull.length_m * hull.draught_m / 100.0 * (1.0 + 50.0 * ratio**2)
        lift = 0.5 * scales.WATER * area * 2.5  # N over u^2 and rad, aspect ratio about 1.5
        turning = np.cov(inputs["delta"], signals["velocity.yaw"])[0, 1]
        sign = float(np.sign(turning)) or 1.0
        terms["N_u^2delta"] = 0.5 * sign * lift * hull.length_m
        terms["Y_u^2delta"] = -sign * lift
    ranges = {
        key: {"low": float(min(x.min(), 0.0)), "high": float(max(x.max(), 1e-6)),
              "start": float(np.clip(np.median(x), min(x.min(), 0.0), max(x.max(), 1e-6)))}
        for key, x in inputs.items()
    }  # fmt: skip
    lines = "".join(f"  {key}: {value:.6f}\n" for key, value in terms.items())
    return lines, yaml.safe_dump({"inputs": ranges}, sort_keys=False)


def _report(reader: Any, run: int) -> None:
    """Print the errors of predicting the mean motion, which a useful model must beat."""
    rows = [row for row in reader.metrics(run) if row.name == METRIC and row.stage == "validation"]
    errors = {(row.dof, row.model): row.value for row in rows if row.value is not None}
    for (dof, model), error in errors.items():
        if model == "mean_motion":
            better = errors.get((dof, "identified"), np.inf) < error
            skill = "" if better else ": the model is no better than the mean motion"
            typer.echo(f"mean motion, {dof}: {error:.4g} {VELOCITY_UNIT[dof]}{skill}")
