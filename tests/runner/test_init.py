"""`seatrial init`, as a new user types it in an empty folder."""

import re

import pytest
import yaml

from tests.runner.command import Command
from tests.runner.programs import rows

FILE = "conf/vessel/tug.yaml"


def written(seatrial: Command, *options: str) -> str:
    answer = seatrial("init", "vessel", "tug", *options)
    assert (answer.code, answer.err) == (0, "")
    first, second = answer.out.splitlines()
    assert first == f"wrote {FILE}"
    assert second.endswith(f" vessel={FILE}")
    return (seatrial.folder / FILE).read_text()


def test_a_vessel_is_written_and_sails(seatrial: Command) -> None:
    """The default trial; a position is kept within half of its length."""
    text = written(seatrial)
    assert len(text.splitlines()) < 60
    seatrial.succeeds(f"vessel={FILE}", "identifier=ls")
    query = "SELECT value FROM metric WHERE model = 'nominal' AND name = 'e_pos_mae'"
    ((error,),) = rows(seatrial.folder, query)
    assert float(str(error)) < 2.5


def test_the_numbers_are_those_of_the_dimensions(seatrial: Command) -> None:
    options = ("--length", "6", "--beam", "2.5", "--draught", "0.7", "--mass", "4000")
    text = written(seatrial, *options)
    assert f"# tug, written by: seatrial init vessel tug {' '.join(options)}\n" in text
    node = yaml.safe_load(text)
    assert node["length_m"] == 6.0
    assert node["inertia"] == [[4000.0, 0.0, 0.0], [0.0, 4000.0, 0.0], [0.0, 0.0, 9000.0]]
    assert node["derivatives"]["Y_vdot"] == pytest.approx(-0.5 * 3.1416 * 1025 * 0.49 * 6, rel=1e-3)
    assert all(isinstance(value, float) for value in node["derivatives"].values())


@pytest.mark.parametrize("length", ["0.15", "5", "350"])
def test_every_number_has_a_unit_and_says_where_to_find_it(seatrial: Command, length: str) -> None:
    text = written(seatrial, "--length", length)
    lines = [line.removeprefix("# ").partition("  # ")[::2] for line in text.splitlines()]
    entries = [line for line in lines if re.match(r" *(- \[|[\w|]+: ).*\d", line[0])]
    assert len(entries) == 17
    assert [entry for entry, comment in entries if len(comment) < 10] == []
    node = yaml.safe_load(text)
    for symbol in node["derivatives"]:
        assert re.search(rf"^  {re.escape(symbol)}: \S+  # \[kg.*\] .{{20}}", text, re.MULTILINE)


def test_what_is_optional_is_right_once_it_is_not_commented(seatrial: Command) -> None:
    text = written(seatrial)
    before, mark, after = text.partition("# force_limits")
    assert mark
    whole = before + re.sub(r"^# ", "", mark + after, flags=re.MULTILINE)
    (seatrial.folder / FILE).write_text(whole)
    node = yaml.safe_load(whole)
    assert {"force_limits", "thruster", "plant_scale", "tuning"} < set(node)
    seatrial.succeeds(f"vessel={FILE}", "identifier=none", "evaluation=none")


def test_a_file_is_not_replaced(seatrial: Command) -> None:
    written(seatrial)
    (seatrial.folder / FILE).write_text("mine")
    assert seatrial.refuses("init", "vessel", "tug") == f"{FILE} exists, expected a new name"
    assert (seatrial.folder / FILE).read_text() == "mine"
    (seatrial.folder / "test_my_fit.py").write_text("mine")
    assert "test_my_fit.py exists" in seatrial.refuses("init", "plugin", "my_fit")


REFUSED = (
    ((), "init: got nothing to start, expected seatrial init vessel NAME or "),
    (("boat", "tug"), "init: no command 'boat', see --help"),
    (("vessel", "../tug"), "init: NAME: got '../tug', expected letters, digits and _"),
    (("vessel", "milliampere"), "vessel milliampere is seatrial's own, expected a new name"),
    (("vessel", "tug", "--length", "long"), "init: --length: got 'long', "),
    (("vessel", "tug", "--length", "1e9"), "length_m must be at most 1000.0, got 1e+09"),
    (("vessel", "tug", "--length", "-1"), "length: got -1 m, expected more than 0"),
    (("vessel", "tug", "seed=1"), "init: unexpected: seed=1"),
    (("plugin", "numpy"), "init plugin: numpy is a module of Python"),
    (("plugin", "ls"), "identifier ls is seatrial's own"),
    (("plugin", "class"), "init plugin: got 'class', expected small letters"),
)


def test_a_command_that_is_wrong(seatrial: Command, subtests: pytest.Subtests) -> None:
    for words, message in REFUSED:
        with subtests.test(words=words):
            assert seatrial.refuses("init", *words).startswith(message)
