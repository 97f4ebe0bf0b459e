"""Two trials are the same if, and only if, what they compute is."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from seatrial.models.source_digest import MODELS_FOLDER
from seatrial.runner.configuration.fingerprint import (
    PACKAGE,
    RUNNER,
    canonical,
    fingerprint,
    source_digest,
)
from seatrial.runner.record.vocabulary import NOT_COMPARED
from seatrial.runner.trials import trial

keys = st.text("abcdef_", min_size=1, max_size=6).filter(lambda key: key not in NOT_COMPARED)
leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(10**12), 10**12)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8)
)
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3)
)
configurations = st.dictionaries(keys, values, max_size=5)
NAMES = {"vessel": "milliampere", "identifier": "ls"}


def of(config: dict[str, Any], names: dict[str, str] = NAMES, sources: str = "0") -> str:
    return fingerprint(config, names, sources)


def shuffled(value: Any) -> Any:
    """The same with the keys of every mapping in reverse order."""
    if isinstance(value, dict):
        return {key: shuffled(value[key]) for key in reversed(value)}
    if isinstance(value, list):
        return [shuffled(item) for item in value]
    return value


@given(configurations)
def test_the_order_of_keys_does_not_matter(config: dict[str, Any]) -> None:
    assert of(config) == of(shuffled(config))


@given(configurations, values)
def test_where_results_go_does_not_matter(config: dict[str, Any], value: Any) -> None:
    for key in NOT_COMPARED:
        assert of(config) == of({**config, key: value})


@given(configurations, keys, values, values)
def test_a_changed_value_matters(config: dict[str, Any], key: str, one: Any, other: Any) -> None:
    # 1, 1.0 and True are equal in Python; only the first two are the same value here.
    assume(canonical(one) != canonical(other))
    assert of({**config, key: one}) != of({**config, key: other})


@given(st.dictionaries(keys, leaves, min_size=1, max_size=5))
def test_a_removed_value_matters(config: dict[str, Any]) -> None:
    fewer = dict(config)
    fewer.popitem()
    assert of(config) != of(fewer)


@given(st.integers(-(10**12), 10**12))
def test_a_whole_number_may_be_written_as_a_float(number: int) -> None:
    assert of({"force": [number]}) == of({"force": [float(number)]})


def test_kinds_of_values_names_and_sources_matter() -> None:
    assert of({"a": True}) != of({"a": 1})
    assert of({"a": 1}) != of({"a": 1}, {"vessel": "milliampere", "identifier": "plsr"})
    assert of({"a": 1}) != of({"a": 1}, sources="1")
    assert of({"a": 1}, {**NAMES, "database": "sqlite"}) == of({"a": 1})


def test_not_a_number_has_no_fingerprint() -> None:
    with pytest.raises(ValueError, match="JSON"):
        of({"a": float("nan")})


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """The sources, to be changed."""
    for folder in (MODELS_FOLDER, RUNNER):
        shutil.copytree(folder, tmp_path / folder.name, ignore=shutil.ignore_patterns("*.pyc"))
    return tmp_path


def digest(checkout: Path) -> str:
    return source_digest(checkout / MODELS_FOLDER.name, checkout / RUNNER.name)


def append(path: Path, text: str) -> None:
    path.write_text(path.read_text() + text)


def test_a_comment_or_a_docstring_in_the_sources_does_not_matter(checkout: Path) -> None:
    for folder in (MODELS_FOLDER, RUNNER):
        for path in (checkout / folder.name).rglob("*.py"):
            first, rest = path.read_text().split('"""', 1)
            path.write_text(f'{first}"""Another word. {rest}\n\n# and a comment\n')
    assert digest(checkout) == source_digest()


@pytest.mark.slow
def test_every_file_that_computes_matters(checkout: Path) -> None:
    """A line of code in any file of models, or that `trial` loads, but for the storage."""
    program = (
        f"import sys, {trial.__name__}\n"
        "for name, module in list(sys.modules.items()):\n"
        f"    if name.startswith('{PACKAGE}.') and not name.startswith('{PACKAGE}.database'):\n"
        "        print(module.__file__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    loaded = {Path(line) for line in done.stdout.splitlines()}
    computing = {"closed_loop.py", "validation_metrics.py"}
    assert loaded >= {RUNNER / "trials" / name for name in computing}
    copies = [checkout / RUNNER.name / path.relative_to(RUNNER) for path in loaded]
    seen = {digest(checkout)}
    for path in [*copies, *(checkout / MODELS_FOLDER.name).rglob("*.py")]:
        append(path, "\nADDED = 1\n")
        seen.add(digest(checkout))
    assert len(seen) == 1 + len(copies) + len(list(MODELS_FOLDER.rglob("*.py")))


def test_what_shows_launches_and_stores_does_not_matter(checkout: Path) -> None:
    for name in ("sweeps/console.py", "sweeps/launching.py", "database/views.py"):
        append(checkout / RUNNER.name / name, "\nADDED = 1\n")
    assert digest(checkout) == source_digest()


def test_a_new_file_of_the_runner_matters_once_it_is_imported(checkout: Path) -> None:
    runner = checkout / RUNNER.name
    (runner / "squared.py").write_text("def square(x):\n    return x * x\n")
    before = digest(checkout)
    assert before == source_digest()
    append(runner / "trials" / "closed_loop.py", f"\nfrom {PACKAGE}.squared import square\n")
    imported = digest(checkout)
    (runner / "squared.py").write_text("def square(x):\n    return x**2\n")
    assert len({before, imported, digest(checkout)}) == 3


def test_a_part_from_elsewhere_counts_by_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file of the class, and what it imports of its package, in a list of parts as well."""
    package = tmp_path / "fleet"
    package.mkdir()
    files = {
        "__init__.py": "from fleet.gusts import Gusts\n",
        "gusts.py": "from fleet.spectra import A\nclass Gusts:\n    pass\n",
        "spectra.py": "A = 1\n",
        "unused.py": "B = 1\n",
    }
    for name, text in files.items():
        (package / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    config = {"disturbance": {"parts": [{"_target_": "fleet.Gusts", "speed": 3.0}]}}
    first = of(config)
    for name, text, counts in (
        ("unused.py", "B = 2\n", False),
        ("gusts.py", f'"""Wind."""\n{files["gusts.py"]}', False),
        ("spectra.py", "A = 2\n", True),
        ("gusts.py", files["gusts.py"].replace("pass", "gain = 2"), True),
    ):
        before = of(config)
        (package / name).write_text(text)
        assert (of(config) != before) == counts, name
    assert of(config) != first


def test_a_part_in_a_single_file_counts_with_its_neighbours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder of one's own; among installed packages everything is a neighbour."""
    for place, counts in (("work", True), ("site-packages", False)):
        folder = tmp_path / place
        folder.mkdir()
        name = f"tug_at_{place.partition('-')[0]}"
        tug = folder / f"{name}.py"
        tug.write_text("from harbour import A\nclass Tug:\n    pass\n")
        (folder / "harbour.py").write_text("A = 1\n")
        with monkeypatch.context() as path:
            path.syspath_prepend(str(folder))
            config = {"vessel": {"_target_": f"{name}.Tug"}}
            first = of(config)
            (folder / "harbour.py").write_text("A = 2\n")
            changed = of(config)
            assert (changed != first) == counts
            tug.write_text("from harbour import A\nclass Tug:\n    mass = 1.0\n")
            assert of(config) != changed
        monkeypatch.delitem(sys.modules, "harbour")


def test_a_wind_file_stands_for_what_is_in_it(tmp_path: Path) -> None:
    def of(name: str) -> str:
        wind = {"variation": "file", "file": str(tmp_path / name)}
        return fingerprint({"disturbance": {"wind": wind, "noise": None}}, {}, "")

    for name, speed in (("a", 5), ("b", 5), ("c", 6)):
        (tmp_path / name).write_text(f"t,speed,direction\n0,{speed},0\n")
    assert of("a") == of("b") != of("c")
    assert fingerprint({"disturbance": {"wind": None}}, {}, "") != of("a")
