"""Malformed options, vessel files and recordings for the runner, drawn by Hypothesis."""

import random
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from hydra import compose, initialize_config_dir
from hypothesis import strategies as st
from omegaconf import OmegaConf

from seatrial.models.errors import ConfigurationError
from seatrial.runner.vessel_options import filled
from tests.abuse.isolated import Order

CONF = Path(__file__).parents[2] / "conf"
GROUPS = ("vessel", "disturbance", "excitation", "identifier", "controller", "evaluation")
SHORT = ("identifier=none", "evaluation=none")
STEERED = ("vessel=kvlcc2", "excitation=rudder_turn", "controller=autopilot", *SHORT)
# Trials that take longer than an input is worth: they are planned, not run.
SLOW = ("auto", "dsr", "grid", "least_squares", "nsga2", "prediction_times", "mix", "operation")
# Options that say how much there is to do, and values that would never end.
SIZE = re.compile(
    r"(?:length_s|duration_s|interval_s|sample_time_s|step_s|horizon|population|generations"
    r"|bootstrap|restarts|pool|square_s|manoeuvre_s|replicates)$"
)
ENDLESS = ("1e9", "1e12", "1000000000", "1e-9", "1e-12", "1e300")
SURGE = (
    *("vessel=surge_linear", "excitation=recording", "identifier=ls", "evaluation=none"),
    *("controller=none", "excitation.columns.orientation=null", "excitation.statistics=[]"),
)
NUMBERS = (
    *("0", "-0", "-1", "1", "2", "0.5", "1e9", "1e12", "-1e12", "1e-9", "1e-12", "1e308", "-1e308"),
    *(
        "1e999",
        "5e-324",
        "inf",
        "-inf",
        "nan",
        ".nan",
        ".inf",
        str(2**31),
        str(2**63),
        "-" + "9" * 40,
    ),
    *("1_000", "0x10", "0o7", "1e", "١٢", "１", "+1", "1,5", "12:30:45"),
)
WORDS = (
    *(
        "",
        "null",
        "~",
        "true",
        "false",
        "yes",
        "abc",
        "surge",
        "none",
        "[]",
        "{}",
        "[[]]",
        "[1,2,3]",
    ),
    *(
        "[1,[2]]",
        "[nan]",
        "[1e308,1e308,1e308]",
        "[[1,0,0],[0,1,0],[0,0,1]]",
        "[[0,0,0],[0,0,0],[0,0,0]]",
    ),
    *(
        "{a:1}",
        "{surge:1}",
        "{surge:{surge:1}}",
        "{_target_:os.nothing}",
        "{_target_:[]}",
        "[" * 50 + "]" * 50,
    ),
    *(
        "${seed}",
        "${nothing}",
        "${oc.env:NOTHING}",
        "${oc.decode:'['}",
        "${",
        "???",
        "'",
        '"',
        "'''",
        "\\",
    ),
    *(
        "a\nb",
        "a\tb",
        "\x1b[31mred\x1b[0m",
        "\x07",
        "\x7f",
        "\x9b31m",
        "\r",
        "\udcff",
        "é",
        "船",
        "\u202e",
    ),
    *("x" * 5000, "%s%n", "../abuse", "=", "==", "a=b", "=SUM(A1)", "@", "!!python/name:os.abort"),
    *(
        "range(0,3)",
        "choice(1,2)",
        "interval(0,1)",
        "glob(*)",
        "/dev/zero",
        "/dev/full",
        "/proc/self/mem",
    ),
)
# A folder may be named by any value of an option, so no text leads out of the case's own.
texts = st.text(
    st.characters(exclude_characters="\0/~", exclude_categories=["Cs"]), max_size=30
).filter(lambda text: ".." not in text)
numbers = st.one_of(
    st.sampled_from(NUMBERS),
    st.sampled_from([10.0**n for n in (-300, -30, -12, -9, 9, 12, 15, 18, 30, 300)]).map(repr),
)
values = st.one_of(numbers, numbers, st.sampled_from(WORDS), texts)


def nothing(folder: Path) -> None:
    """Prepare no file."""


def _leaves(node: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if name:
        yield name, node
    items = node.items() if isinstance(node, dict) else ()
    for key, value in items:
        yield from _leaves(value, f"{name}.{key}" if name else str(key))


def choices() -> dict[str, list[str]]:
    """The names of all choices of each group."""
    return {group: sorted(file.stem for file in (CONF / group).glob("*.yaml")) for group in GROUPS}


@dataclass(frozen=True)
class Trial:
    """A trial with one choice of one group: every key that it resolves to, by kind."""

    overrides: tuple[str, ...]
    slow: bool
    keys: tuple[str, ...]
    numeric: tuple[str, ...]  # keys of numbers
    sizes: tuple[str, ...]  # keys of numbers that say how much there is to do


def _composed(
    short: Sequence[str], group: str, name: str
) -> tuple[tuple[str, ...], list[tuple[str, Any]]]:
    """The overrides of a short trial with a choice, and what they resolve to."""
    overrides = (*(one for one in short if not one.startswith(f"{group}=")), f"{group}={name}")
    plain: Any = OmegaConf.to_container(compose("trial", list(overrides)), resolve=True)
    return overrides, list(_leaves(filled(plain)))


def trials() -> list[Trial]:
    """A trial with each choice of each group."""
    result = []
    with initialize_config_dir(str(CONF), version_base="1.3"):
        for group, names in choices().items():
            for name in names:
                try:
                    overrides, leaves = _composed(SHORT, group, name)
                except ConfigurationError:  # it needs a vessel with inputs, or is one
                    overrides, leaves = _composed(STEERED, group, name)
                numeric = tuple(key for key, value in leaves if isinstance(value, (int, float)))
                sizes = tuple(
                    key for key in numeric if SIZE.search(key) and not key.startswith("vessel.")
                )
                keys = (*(key for key, _ in leaves), *GROUPS)
                result.append(Trial(overrides, name in SLOW, keys, numeric, sizes))
    return result


def options() -> st.SearchStrategy[Order]:
    """One or two keys of a trial's resolved configuration with values that may be anything."""
    every = trials()
    sized = [trial for trial in every if trial.sizes]

    @st.composite
    def anything(draw: st.DrawFn) -> Order:
        trial = draw(st.sampled_from(every))
        pools = [trial.keys, trial.numeric or trial.keys, trial.numeric or trial.keys]
        changed = []
        for _ in range(draw(st.integers(1, 2))):
            number, pool = draw(st.sampled_from(list(enumerate(pools))))
            key = draw(st.sampled_from(pool))
            sign = draw(st.sampled_from(("", "", "", "", "+", "++", "~")))
            value = draw(numbers if number == 2 else values)
            changed.append(f"~{key}" if sign == "~" else f"{sign}{key}={value}")
        mode = draw(st.sampled_from((("dry_run=true",), (), ("-m",))))
        dry = ("dry_run=true",) if trial.slow and "dry_run=true" not in mode else ()
        return Order("seatrial", (*mode, *trial.overrides, *changed, *dry), nothing)

    @st.composite
    def endless(draw: st.DrawFn) -> Order:
        trial = draw(st.sampled_from(sized))
        key, value = draw(st.sampled_from(trial.sizes)), draw(st.sampled_from(ENDLESS))
        return Order("seatrial", (*trial.overrides, f"{key}={value}"), nothing)

    return st.one_of(anything(), anything(), anything(), endless())


# Vessels: a file of conf/vessel, spoilt.

WHOLE_VESSELS: tuple[bytes, ...] = (
    b"",
    b"\n",
    b"null\n",
    b"[]\n",
    b"text\n",
    b"- a\n- b\n",
    b"\xff\xfe\x00\x01",
    b"\xef\xbb\xbfname: bom\n",
    "name: wide\n".encode("utf-16"),
    b"\x00" * 100,
    b"\tname: tab\n",
    b"a: b: c\n",
    b"name: &x [*x]\n",
    b"? [a]\n: b\n",
    b"!!python/object/apply:os.abort []\n",
    b"%YAML 9.9\n---\n",
    b"--- a\n--- b\n",
    b"[" * 3000,
    b"{a: " * 500,
    b" " * 5_000_000,
)


def _spots(node: Any) -> Iterator[tuple[Any, Any]]:
    """Every place of a tree: a container and its key."""
    pairs = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in list(pairs):
        yield node, key
        if isinstance(value, (dict, list)):
            yield from _spots(value)


NODES: tuple[Any, ...] = (
    *(None, True, "", "abc", "\x1b[31m", 0, -1, 1.0, 1e18, -1e300, float("nan"), float("inf")),
    *([], {}, [1.0], [[1.0]], [[1.0, 2.0], [3.0]], {"a": 1}, [None], ["surge"], 10**40, "x" * 5000),
    *([[1e20, 0.0, 0.0], [0.0, 1e-20, 0.0], [0.0, 0.0, 1.0]], "${nothing}", "???", ["surge"] * 7),
)


def vessels() -> st.SearchStrategy[Order]:
    """A vessel of one's own whose file is malformed."""
    files = sorted((CONF / "vessel").glob("*.yaml"))

    @st.composite
    def tree(draw: st.DrawFn) -> bytes:
        config = yaml.safe_load(draw(st.sampled_from(files)).read_text())
        for _ in range(draw(st.integers(1, 3))):
            container, key = draw(st.sampled_from(list(_spots(config))))
            if draw(st.booleans()):
                container[key] = draw(st.sampled_from(NODES))
            elif isinstance(container, dict):
                container.pop(key, None)
                if draw(st.booleans()):
                    container[
                        draw(st.sampled_from(("", "X_u", "Y_|v|v", "_target_", "1", "é")))
                    ] = 1.0
        return yaml.safe_dump(config, allow_unicode=True).encode()

    @st.composite
    def text(draw: st.DrawFn) -> bytes:
        lines = draw(st.sampled_from(files)).read_text().splitlines()
        spot = draw(st.integers(0, len(lines) - 1))
        change = draw(st.sampled_from(("double", "insert", "indent", "cut")))
        if change == "double":
            lines.insert(spot, lines[spot])
        elif change == "insert":
            lines.insert(spot, draw(texts))
        elif change == "indent":
            lines[spot] = " " + lines[spot]
        else:
            lines[spot] = lines[spot][: draw(st.integers(0, len(lines[spot])))]
        return "\n".join(lines).encode("utf-8", "surrogateescape")

    def order(content: bytes, dry: bool) -> Order:
        def prepare(folder: Path) -> None:
            file = folder / "conf" / "vessel" / "own.yaml"
            file.parent.mkdir(parents=True)
            file.write_bytes(content)

        overrides = (
            "vessel=own",
            "identifier=ls",
            "evaluation=none",
            *(("dry_run=true",) if dry else ()),
        )
        return Order("seatrial", ("--config-dir", "conf", *overrides), prepare)

    contents = st.one_of(tree(), tree(), tree(), text(), text(), st.sampled_from(WHOLE_VESSELS))
    return st.builds(order, contents, st.booleans())


# Recordings: a file that would be read, spoilt.


def recording(n: int = 200) -> list[list[str]]:
    """A recording of surge that can be identified: header and samples of 10 Hz."""
    chance = random.Random(3)
    rows = [["Time", "position_x", "surge_vel", "force_x"]]
    x = u = 0.0
    for k in range(n):
        force = 60.0 * chance.choice((-1, 0, 1))
        rows.append([f"{0.1 * k:.10g}", f"{-x:.6f}", f"{-u:.6f}", f"{-force:.3f}"])
        x, u = x + 0.1 * u, u + 0.1 * (force - 20.0 * u) / 60.0
    return rows


CELLS = (
    *NUMBERS,
    *(
        "",
        " ",
        '"',
        '""',
        "'",
        "abc",
        "\x1b[31m",
        "\x00",
        "\r",
        "\n",
        ";",
        ",",
        ",,,",
        "=1+1",
        "x" * 5000,
    ),
    *("1 2", "1e5000", "9" * 400, "٣", "NaN", "NA", "null", "True", "0.1", "-0.1", "2026-01-01"),
)
WHOLE_RECORDINGS: tuple[bytes, ...] = (
    *(b"", b"\n", b",\n", b"Time\n", b"Time,position_x,surge_vel,force_x\n", b"\xff\xfe\x00"),
    *(
        b"\x00" * 100,
        b"Time," * 200_000 + b"\n1\n",
        b"1" * 3_000_000,
        b'"' * 1001,
        b'"' + b"\n" * 1000,
    ),
    "\n".join(",".join(row) for row in recording()).encode("utf-16"),
    b"\xef\xbb\xbf" + "\n".join(",".join(row) for row in recording()).encode(),
    *("\n".join(",".join(row) for row in recording(n)).encode() for n in (1, 2, 3, 5, 8)),
    "\r".join(",".join(row) for row in recording()).encode(),
    "\n".join(";".join(row) for row in recording()).encode(),
    b"PAR1" + bytes(range(256)),
)


def recordings() -> st.SearchStrategy[Order]:
    """A recording whose file is malformed."""

    @st.composite
    def spoilt(draw: st.DrawFn) -> bytes:
        rows = recording()
        for _ in range(draw(st.integers(1, 3))):
            spot = draw(st.integers(0, len(rows) - 1))
            change = draw(
                st.sampled_from(
                    ("cell", "cell", "cell", "drop", "double", "short", "column", "header")
                )
            )
            if change == "cell" and rows[spot]:
                rows[spot][draw(st.integers(0, len(rows[spot]) - 1))] = draw(st.sampled_from(CELLS))
            elif change == "drop" and len(rows) > 1:
                del rows[spot]
            elif change == "double":
                rows.insert(spot, list(rows[spot]))
            elif change == "short":
                rows[spot] = rows[spot][: draw(st.integers(0, 4))]
            elif change == "column":
                cell, column = draw(st.sampled_from(CELLS)), draw(st.integers(0, 3))
                rows[1:] = [
                    [cell if i == column else old for i, old in enumerate(row)] for row in rows[1:]
                ]
            elif change == "header" and rows[0]:
                rows[0][0] = draw(st.one_of(texts, st.sampled_from(("Time", "force_x", ""))))
        return "\n".join(",".join(row) for row in rows).encode("utf-8", "surrogateescape")

    def order(content: bytes, extra: tuple[str, ...]) -> Order:
        def prepare(folder: Path) -> None:
            (folder / "own.csv").write_bytes(content)

        return Order("seatrial", (*SURGE, "excitation.path=own.csv", *extra), prepare)

    contents = st.one_of(spoilt(), spoilt(), spoilt(), st.sampled_from(WHOLE_RECORDINGS))
    extra = st.sampled_from(
        (
            (),
            (),
            ("excitation.resample_hz=5",),
            ("excitation.outliers.replace=true",),
            ("excitation.differentiation.method=butterworth",),
            ("excitation.trip_starts_s=[0,5,10]", "excitation.training_trips=[1,2]"),
        )
    )
    return st.builds(order, contents, extra)
