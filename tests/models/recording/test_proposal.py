"""Columns are recognised by their titles as loggers of many kinds write them."""
# ruff: noqa: E501

from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import yaml

from seatrial.models.errors import RecordingError
from seatrial.models.recording.diagnosis import doubts
from seatrial.models.recording.proposal import Proposal, propose
from seatrial.models.recording.source import Source, TextArray
from seatrial.models.vessel.basis import Array
from seatrial.runner.configuration.named_files import options_of, reader_of

DEG = "57.29578"
LOGGERS = yaml.safe_load(Path(__file__).with_name("loggers.yaml").read_text(encoding="utf-8"))


def _signals() -> dict[str, Array]:
    """A vessel of 2 m/s that turns to both sides, at 5 Hz for 10 minutes."""
    t = np.arange(0.0, 600.0, 0.2)
    r = 0.06 * np.sin(0.05 * t) + 0.03 * np.sin(0.021 * t + 1.0)
    psi = np.concatenate([[0.0], np.cumsum(0.1 * (r[1:] + r[:-1]))]) + 0.3
    u, v = 2.0 + 0.3 * np.sin(0.03 * t), -0.5 * r
    vn, ve = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    x, y = (np.concatenate([[0.0], np.cumsum(0.1 * (d[1:] + d[:-1]))]) for d in (vn, ve))
    wave = {name: 0.1 * np.sin((0.3 + 0.1 * k) * t) for k, name in enumerate(
        ("phi", "theta", "p", "q", "w", "z", "delta"))}  # fmt: skip
    return {
        "t": t, "x": x, "y": y, "psi": psi % (2.0 * np.pi), "u": u, "v": v, "r": r, "vn": vn, "ve": ve, **wave,
        "lat": 59.0 + x / 111_195.0, "lon": 24.0 + y / 111_195.0 / np.cos(np.radians(59.0)),
        "qw": np.cos(0.5 * psi), "qz": np.sin(0.5 * psi), "sog": np.hypot(vn, ve), "stw": u,
        "cog": np.arctan2(ve, vn) % (2.0 * np.pi), "tws": 5.0 + u, "twd": 3.0 + r, "pwm": 1500.0 + 400.0 * np.sin(t),
        "n": 5.0 + u, "X": 500.0 * u, "Y": 400.0 * r, "N": 200.0 * r, "T": 30.0 + np.cos(0.01 * t),
    }  # fmt: skip


def _sources(text: str, units: dict[str, str] | None = None) -> dict[str, Source]:
    known = _signals()
    sources = {}
    for line in text.splitlines():
        name, _, titles = line.partition(": ")
        columns: dict[str, Array | TextArray] = {}
        for title, _, signal in (item.strip().partition("=") for item in titles.split(";")):
            signal_name, _, size = signal.partition("*")
            values = known.get(signal_name)
            values = np.full(len(known["t"]), float(signal_name)) if values is None else values
            columns[title] = values * float(size or 1.0)
        sources[name] = Source(name, Path("log.csv"), columns, units or {})
    return sources


@pytest.mark.parametrize("logger", LOGGERS)
def test_columns_of_a_logger(logger: str) -> None:
    assert propose(_sources(LOGGERS[logger]["sources"])).map == LOGGERS[logger]["map"]


def _said(titles: str, wanted: tuple[str, ...] = (), **units: str) -> Proposal:
    return propose(_sources(f"log: t=t; x=x; y=y; {titles}", units), wanted)


def test_inputs_have_the_names_of_the_vessel() -> None:
    acting = "psi=psi; RPM=n*60; Helm=delta; rudder_cmd=T; tau_x=X; thr_left=T; thr_right=pwm"
    named, numbered = "psi=psi; n_prop=n; delta_rudder=delta", "psi=psi; n_2=n; n_1=T"
    for titles, inputs in (
        (acting, {"delta": "Helm", "n": {"column": "RPM", "unit": "rpm"}}),
        (acting, {"pwm_1": "thr_left", "pwm_2": "thr_right"}),
        (named, {"n": "n_prop", "delta": "delta_rudder"}),
        (numbered, {"n_1": "n_1", "n_2": "n_2"}),
        ("psi=psi; sail_winch=delta; sail_load=T", {"sail_winch": "sail_winch"}),
        ("psi=psi; flap_angle=delta", {"flap": "flap_angle"}),
    ):
        found = _said(titles, tuple(inputs)).map
        assert found["inputs"] == inputs
        assert "force" not in found
    for titles, wanted, columns in (
        (numbered, ("n",), "n_1, n_2"),
        ("psi=psi; delta=delta", ("delta", "n"), "no column looks like it"),
    ):
        (question,) = _said(titles, wanted).questions
        assert f"which column is the input n of the vessel? ({columns})" in question
    forces = _said(acting)
    assert "inputs" not in forces.map
    assert any("RPM" in line and "look like inputs" in line for line in forces.left_out)


@pytest.mark.parametrize(
    ("titles", "question"),
    [
        ("depth=z; roll=phi*572.9", "roll ranges from"),
        (f"psi=psi; rudder=delta*{DEG}", "rudder ranges from"),
        ("psi=psi; rpm_shaft=n; shaft=n*60", "shaft ranges from"),
        ("psi=psi; pwm_1=pwm", "in which unit, or which value is full?"),
        ("heading_magnetic=psi", "magnetic heading"),
    ],
)  # fmt: skip
def test_what_the_range_makes_doubtful_is_asked(titles: str, question: str) -> None:
    proposal = _said(titles)
    columns = reader_of(Path("log.csv"), options_of(deepcopy(proposal.map))).columns
    lines = doubts(_sources(f"log: t=t; x=x; y=y; {titles}"), columns).values()
    assert any(question in line for line in (*proposal.questions, *lines))
    assert "0.0174" not in str(proposal.map)


def test_units_of_the_header_are_not_repeated_and_count_for_those_beside() -> None:
    proposal = _said(f"psi=psi*{DEG}; roll=phi*{DEG}; heave=z", psi="deg", heave="m")
    assert proposal.map["position"] == {
        "surge": "x", "sway": "y", "heave": "heave", "roll": {"column": "roll", "unit": "deg"}, "yaw": "psi"
    }  # fmt: skip
    assert not proposal.questions


def test_course_is_no_heading_and_what_is_left_out_is_named() -> None:
    sources = _sources(
        "log: t=t; lat=lat; lon=lon; COG=cog; SOG=sog; STW=stw; note=0; engine_temp=T"
    )
    columns = dict(sources["log"].columns)
    columns["SOG"] = np.where(np.arange(len(columns["SOG"])) < 3, np.nan, columns["SOG"])
    columns["state"] = np.array(["on"] * len(columns["SOG"]), dtype=np.object_)
    proposal = propose({"log": Source("log", Path("log.csv"), columns)})
    assert set(proposal.map) == {"time", "geodetic"}
    text = "\n".join(proposal.left_out)
    assert all(name in text for name in ("COG", "SOG", "STW", "note", "engine_temp", "state"))
    with pytest.raises(RecordingError, match="no column of time among"):
        propose({name: Source(name, Path("log"), {"x": columns["lat"]}) for name in "ab"})


@pytest.mark.parametrize(
    ("title", "line"),
    [("t", "t in s (no unit is stated)"), ("TimeUS", "TimeUS in us (the title)"),
     ("elapsed", "elapsed_time in ms (the file)"), ("stamp", "stamp in ms (by its numbers)")],
)  # fmt: skip
def test_where_the_time_is_known_from(title: str, line: str) -> None:
    name = "elapsed_time" if title == "elapsed" else title
    size = {"t": "1", "TimeUS": "1e6"}.get(title, "1e3")
    units = {name: "ms"} if title == "elapsed" else {}
    proposal = propose(_sources(f"log: {name}=t*{size}; x=x; y=y; psi=psi", units))
    assert proposal.sure[0] == f"time: {line}"


def test_cells_that_are_missing_are_counted() -> None:
    sources = _sources("log: t=t; x=x; y=y; psi=psi")
    sources["log"].columns["x"][:3] = np.nan
    proposal = propose(sources)
    assert proposal.map["position"] == {"surge": "x", "sway": "y", "yaw": "psi"}
    assert any("x (3 of 3000)" in line for line in proposal.left_out)
