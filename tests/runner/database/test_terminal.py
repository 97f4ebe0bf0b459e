"""Text that is printed: no control characters, bounded echoes, and no formulas in spreadsheets."""

import io
import logging
import sys
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.runner.database.mask import MaskedFormatter, masked_output, styled
from seatrial.runner.database.terminal import ECHOED, error_line, guarded, shortened, visible


def commands_terminal(letter: str) -> bool:
    """Whether a character is no letter: C0, C1, DEL, a bidi override or a lone surrogate."""
    code = ord(letter)
    return (
        (code < 0x20 and letter not in "\t\n")
        or 0x7F <= code < 0xA0
        or 0x202A <= code <= 0x202E
        or 0x2066 <= code <= 0x2069
        or 0xD800 <= code < 0xE000
    )


@given(st.text())
def test_what_is_visible_commands_no_terminal(text: str) -> None:
    shown = visible(text)
    assert not any(map(commands_terminal, shown))
    assert visible(shown) == shown
    letters = "".join(letter for letter in text if not commands_terminal(letter))
    if letters.isprintable() and letters == text:
        assert shown == text


def test_every_control_character_has_an_escape() -> None:
    for code in range(0x11000):
        if commands_terminal(chr(code)):
            assert visible(chr(code)).encode("ascii").decode("unicode_escape") == chr(code)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_streams_escape_unless_a_renderer_of_colours_writes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setattr(sys, "stderr", terminal)
    with masked_output():
        print("\x1b[2J\x9b2J\u202e\udcff")
        print("\x1b]0;title\x07", file=sys.stderr)
        print("\x1b[1mbold\x1b[0m postgresql://me:secret@host", file=styled(sys.stdout))
    first, second, third = terminal.getvalue().splitlines()
    assert first == r"\x1b[2J\x9b2J\u202e\udcff"
    assert second == r"\x1b]0;title\x07"
    assert third == "\x1b[1mbold\x1b[0m postgresql://me:***@host"


def test_a_stream_that_is_not_utf8_gets_question_marks(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    with masked_output():
        print("1 ± 2", flush=True)
    assert raw.getvalue() == b"1 ? 2\n"


def test_a_line_of_the_log_is_visible_and_masked() -> None:
    record: Any = logging.LogRecord(
        "x", logging.INFO, "", 0, "name \x1b[8m at %s", ("postgresql://me:secret@host",), None
    )
    assert MaskedFormatter("%(message)s").format(record) == (
        r"name \x1b[8m at postgresql://me:***@host"
    )


LONG = "y" * 5000
SPACED = "u v " * 1000


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        (f"--metric: no metric {LONG!r}; expected one of force_mse", ()),
        (f"vessel: got {SPACED.strip()}, expected one of a, b", (f"vessel={SPACED}",)),
        (f"cannot read {SPACED!r}; expected a name", ()),
        (f"{LONG}: unknown option", ()),
        (f"got {LONG + chr(39) + chr(34) + LONG!r}", ()),
        (f"got {'z w' * 900!r}, {LONG}", ("z w" * 900,)),
    ],
)
def test_a_message_echoes_little(message: str, arguments: tuple[str, ...]) -> None:
    line = error_line(message, arguments)
    echoed = sum(line.count(letter) for letter in "yuvzw")
    assert echoed <= 2 * ECHOED
    for part in ("y" * ECHOED, "u v " * (ECHOED // 4), "z w" * (ECHOED // 3)):
        assert part not in line
    assert "characters" in line
    assert line.startswith(message[:5])


@given(st.text())
def test_a_message_is_one_line_of_bounded_length(message: str) -> None:
    line = error_line(message * 100)
    assert len(line) <= 4000
    assert "\n" not in line
    assert not any(map(commands_terminal, line))


def test_a_short_message_is_left_alone() -> None:
    for message in (
        "--where: expected a value, got 'x' at character 9",
        "expected one of " + ", ".join(f"metric_{number}" for number in range(100)),
        "the controller's gain isn't the vessel's " + "and so on " * 60 + "of the plant's",
    ):
        assert error_line(message) == message.strip()


@given(st.text())
def test_what_is_shortened_keeps_both_ends(text: str) -> None:
    assert shortened(text[:ECHOED]) == text[:ECHOED]
    long = text + LONG + text
    assert len(shortened(long)) <= ECHOED
    assert long.startswith(shortened(long)[:50])
    assert long.endswith(shortened(long)[-50:])


@pytest.mark.parametrize(
    "text", ["=1+1", "+cmd", "-2+3", "@SUM(A1)", "\t=1", "\r=1", "\uff1d1", "-", "+", "--x", "-1 2"]
)
def test_a_formula_becomes_text(text: str) -> None:
    assert guarded(text) == "'" + text


@pytest.mark.parametrize(
    "value", ["", "ls", "a=b", "-1", "+0.5", "-1e-3", "-.5", "-inf", "1-2", -1.0, -3, None, True]
)
def test_numbers_and_other_text_stay(value: object) -> None:
    assert guarded(value) == value
