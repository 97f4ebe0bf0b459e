"""The language of --where: what it means, and that nothing else gets through."""

from contextlib import suppress
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.compare.table import comparison
from seatrial.runner.compare.where import parse
from seatrial.runner.database import LogbookWriter
from tests.runner.compare import stored
from tests.runner.postgres import Postgres

INJECTIONS = (
    "seed<3; DROP TABLE run", "1=1", "seed=1 OR 1=1", "seed=1--",
    "identifier='ls' UNION SELECT * FROM run", "seed=(select max(seed) from run)",
    "lower(identifier)=ls", "run.seed=1", "config=1", "traceback!=null", 'identifier"=ls',
    "identifier.force') OR 1=1", "identifier.'force'=1", "seed=1 /* */", "seed[0]=1",
    "status like 'f%'", "seed=1 and", "(seed=1", "seed=1)", "seed", "seed in ()",
    "not", "seed < true", "seed=1 seed=2", "rowid=1", "identifier==\x00",
)  # fmt: skip


@pytest.mark.parametrize("truth", [*product([False, True], repeat=3)])
def test_precedence_is_not_then_and_then_or(truth: tuple[bool, ...]) -> None:
    held = dict(zip("abc", map(np.bool_, truth), strict=True))
    a, b, c = truth
    met = parse("a=1 and not b=1 or c=1", lambda name, operator, value: held[name])
    assert met == ((a and not b) or c)


def test_values_have_the_type_they_look_like() -> None:
    found = []
    parse("a in (1, 2.5, -3e2, ls, 'it''s', \"2\", true, null)", lambda *read: found.append(read))
    assert found == [("a", "in", [1, 2.5, -300.0, "ls", "it's", "2", "true", None])]


def test_anything_but_comparisons_of_known_names_is_refused(
    results: Queries, subtests: pytest.Subtests
) -> None:
    for text in INJECTIONS:
        with subtests.test(text):
            with pytest.raises(ConfigurationError) as refused:
                results.runs(results.where(text))
            assert "\n" not in str(refused.value)


@given(st.text(max_size=60))
def test_no_text_is_more_than_refused(text: str) -> None:
    with suppress(ConfigurationError):
        parse(text, lambda *_: np.True_)


def test_deep_nesting_is_refused_and_not_a_crash() -> None:
    for text in ("(" * 5000, "not " * 5000 + "seed=1"):
        with pytest.raises(ConfigurationError, match="cannot read"):
            parse(text, lambda *_: np.True_)


SELECTIONS = (
    ("identifier=ls", 6),
    ("identifier!=ls", 11),
    ("identifier in (ls, plsr)", 11),
    ("identifier not in (ls, plsr)", 6),
    ("identifier = \"ls' OR '1'='1\"", 0),  # only a value
    ("seed>=1 and seed<=1", 6),
    (f"seed in ({', '.join(map(str, range(1, 5000)))})", 11),
    ("not (seed>=1)", 6),
    ("status=failed or status=diverged", 2),
    ("plant.scale=0.5", 17),
    ("plant.scale<0.5", 0),
    ("identifier.force=filtered and lap=true", 17),
    ("lap=false", 0),
    ("lap!=false", 17),
    ("lowpass_hz=null", 17),
    ("lowpass_hz!=null", 0),
    ("lowpass_hz!=0.5", 17),
    ("identifier.force<3", 0),
    ("started_at>2020-01-01", 17),
    ("started_at<2020-01-01T12:00", 0),
    ("error!=null", 2),
    ("git_dirty=true", 17),
    ("sweep_id=null", 17),
)


def test_conditions_select_by_hand_counted_numbers(results: Queries) -> None:
    assert {text: _selected(results, text) for text, _ in SELECTIONS} == dict(SELECTIONS)


def test_conditions_mean_the_same_on_postgresql(postgres: Postgres, tmp_path: Path) -> None:
    url = postgres.new_database()
    with LogbookWriter.open(url, results_dir=tmp_path) as logbook:
        stored.fill_plain(logbook)
    with open_results(url, tmp_path) as results:
        found = {text: _selected(results, text) for text, _ in SELECTIONS}
        shown = comparison(results, TableOptions("identifier.force", pool=["identifier"]))
    assert found == dict(SELECTIONS)
    assert [row[1].text for row in shown.rows] == ["filtered", "filtered"]  # surge and yaw


def _selected(results: Queries, text: str) -> int:
    try:
        return len(results.runs(results.where(text)))
    except ConfigurationError as none:
        if "no runs match" in str(none):
            return 0
        raise


def test_a_name_or_a_value_that_is_wrong_is_answered_with_what_is_expected(
    results: Queries,
) -> None:
    for text, expected in (
        ("identifer=ls", r"--where: 'identifer' is not known; did you mean id"),
        ("seed=x", "seed is compared with a number, got 'x'"),
        ("started_at>soon", "started_at is compared with a date"),
        ("git_dirty=1", "git_dirty is compared with true or false"),
        ("seed<null", "cannot read 'seed<null' at character 1"),
    ):
        with pytest.raises(ConfigurationError, match=expected):
            results.where(text)
