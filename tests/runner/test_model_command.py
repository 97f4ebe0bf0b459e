"""From a boat's log to a model that sails, and sweeps over recordings of which one is bad."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from tests.runner.command import Command

PERIOD = 0.2
MASS, DRAG = np.array([4300.0, 7000.0, 16000.0]), np.array([420.0, 1500.0, 9000.0])


def log_of_a_boat(path: Path, **changes: object) -> Path:
    """Twelve minutes of a linear vessel in surge, sway and yaw, in knots and degrees."""
    rng = np.random.default_rng(3)
    n = 3600
    force = np.repeat(rng.uniform(-1.0, 1.0, (n // 60, 3)), 60, axis=0) * [800.0, 300.0, 700.0]
    force[:, 0] += 600.0
    pose, speed, rows = np.zeros(3), np.zeros(3), []
    for tau in force:
        rows.append([*pose, *speed])
        for _ in range(10):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            way = [c * speed[0] - s * speed[1], s * speed[0] + c * speed[1], speed[2]]
            pose = pose + 0.1 * PERIOD * np.array(way)
            speed = speed + 0.1 * PERIOD * (tau - DRAG * speed) / MASS
    x, y, psi, u, v, r = np.array(rows).T
    noise = rng.normal(0.0, 1.0, (6, n)) * [[0.02], [0.02], [0.1], [0.02], [0.02], [0.1]]
    table = {
        "time": PERIOD * np.arange(n), "north": x + noise[0], "east": y + noise[1],
        "heading_deg": (np.degrees(psi) + noise[2]) % 360.0, "u_kn": u / 0.514444 + noise[3],
        "v_kn": v / 0.514444 + noise[4], "yaw_rate_deg_s": np.degrees(r) + noise[5],
        "force_x_N": force[:, 0], "force_y_N": force[:, 1], "moment_z_Nm": force[:, 2],
    }  # fmt: skip
    pd.DataFrame({**table, **changes}).round(4).to_csv(path, index=False)
    return path


@pytest.mark.slow
def test_a_log_becomes_a_model_that_sails(seatrial: Command) -> None:
    log_of_a_boat(seatrial.folder / "boat.csv")
    answer = seatrial.succeeds("model", "boat.csv", "--length", "6", "--mass", "4000")
    assert "run 1 finished" in answer.out
    assert "no better than the mean motion" not in answer.out
    node = yaml.safe_load((seatrial.folder / "boat_model.yaml").read_text())
    assert node["standard_errors"]["X_udot"] > 0.0
    mass = np.diag(node["inertia"])  # the added mass is in it
    np.testing.assert_allclose(mass, MASS, rtol=0.1)
    seatrial.succeeds("vessel=boat_model.yaml", "identifier=none", "evaluation=none")
    said = seatrial.refuses("model", "boat.csv", "--length", "6")
    assert "boat_model.yaml: exists already, expected a new name or --force" in said


def test_it_stops_at_what_must_be_answered_with_the_line_to_add(seatrial: Command) -> None:
    """Pulses that drive two thrusters: only their owner knows which width is none."""
    width = np.round(1500 + 200 * np.sin(0.01 * np.arange(3600)))
    path = log_of_a_boat(seatrial.folder / "boat.csv", thr_left=width, thr_right=width[::-1])
    table = pd.read_csv(path)
    table.drop(columns=[c for c in table if c.startswith(("force", "moment"))]).to_csv(path)
    answer = seatrial("model", "boat.csv", "--length", "6")
    assert answer.code == 2
    assert "neutral: 1500" in answer.err
    assert "boat.map.yaml" in answer.err


@pytest.mark.slow
def test_thrust_is_a_share_of_what_its_owner_calls_full(seatrial: Command) -> None:
    path = log_of_a_boat(seatrial.folder / "boat.csv")
    table = pd.read_csv(path)
    ahead, turning = table["force_x_N"], table["moment_z_Nm"]
    table["thrust_stbd"], table["thrust_port"] = 0.5 * (ahead - turning), 0.5 * (ahead + turning)
    table.drop(columns=["force_x_N", "force_y_N", "moment_z_Nm"]).to_csv(path, index=False)
    words = "model", "boat.csv", "--length", "6", "--mass", "4000"
    answer = seatrial(*words)
    assert answer.code == 2
    assert "which value is full? inputs: {pwm_1: {column: thrust_port, neutral: 0, full: " in (
        answer.err.replace("\n", " ")
    )
    file = seatrial.folder / "boat.map.yaml"
    node = yaml.safe_load(file.read_text())
    assert node["inputs"] == {"pwm_1": "thrust_port", "pwm_2": "thrust_stbd"}
    full = {name: {"column": c, "neutral": 0, "full": 1000} for name, c in node["inputs"].items()}
    file.write_text(yaml.safe_dump({**node, "inputs": full}))
    told = seatrial.succeeds(*words, "--map", "boat.map.yaml").out
    assert "run 1 finished" in told
    assert not any("no better" in line for line in told.splitlines() if "surge" in line)
    seatrial.succeeds("vessel=boat_model.yaml", "identifier=none", "evaluation=none")


def test_what_cannot_be_done_is_one_line(seatrial: Command) -> None:
    log_of_a_boat(seatrial.folder / "boat.csv")
    for words, message in (
        ("none.csv --length 6", "none.csv: there is no such file"),
        ("boat.csv", "expected --length of the boat [m], or --vessel NAME"),
        ("boat.csv --length long", "model: --length: got 'long', expected a number"),
    ):
        assert message in seatrial.refuses("model", *words.split())
    table = pd.read_csv(seatrial.folder / "boat.csv").iloc[:, :7]
    table.to_csv(seatrial.folder / "motion.csv", index=False)
    answer = seatrial("model", "motion.csv", "--length", "6")
    assert answer.code == 2
    assert "motion.map.yaml: got inputs none, expected force" in answer.err
    assert not (seatrial.folder / "conf").exists()


@pytest.mark.slow
def test_one_bad_recording_does_not_stop_a_sweep(seatrial: Command) -> None:
    """Contents that cannot be trusted fail their run; a path that is not there refuses all."""
    log_of_a_boat(seatrial.folder / "good.csv")
    lost = np.random.default_rng(1).normal(size=3600).cumsum()
    log_of_a_boat(seatrial.folder / "wrong.csv", u_kn=lost)
    (seatrial.folder / "damaged.csv").write_text("time,north\n1,2,3\n")
    (seatrial.folder / "map.yaml").write_text(
        "time: time\n"
        "position: {surge: north, sway: east, yaw: heading_deg}\n"
        "velocity: {surge: u_kn, sway: v_kn, yaw: yaw_rate_deg_s}\n"
        "force: {surge: force_x_N, sway: force_y_N, yaw: moment_z_Nm}\n"
    )
    words = ("-m", "vessel=milliampere", "excitation=recording", "identifier=none")
    words += ("excitation.map=map.yaml", "controller=none", "evaluation=none")
    answer = seatrial(*words, "excitation.path=good.csv,wrong.csv,damaged.csv")
    assert answer.code == 1, answer
    assert "1 finished" in answer.out
    assert "2 failed" in answer.out
    said = seatrial.refuses(*words, "excitation.path=good.csv,absent.csv")
    assert "absent.csv: there is no such file" in said
