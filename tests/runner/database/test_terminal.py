"""Messages are one line of a bounded length without control characters."""

from hypothesis import given
from hypothesis import strategies as st

from seatrial.runner.database.terminal import error_line, visible


def controls_terminal(letter: str) -> bool:
    """Whether a character is no text: C0, C1, DEL, a bidi override or a lone surrogate."""
    code = ord(letter)
    return (
        (code < 0x20 and letter not in "\t\n")
        or 0x7F <= code < 0xA0
        or 0x202A <= code <= 0x202E
        or 0x2066 <= code <= 0x2069
        or 0xD800 <= code < 0xE000
    )


def test_every_control_character_has_an_escape_and_no_other_character() -> None:
    for letter in map(chr, range(0x11000)):
        shown = visible(letter)
        if controls_terminal(letter):
            assert shown.encode("ascii").decode("unicode_escape") == letter
        else:
            assert shown == letter


@given(st.text())
def test_a_message_is_one_line_of_bounded_length(message: str) -> None:
    line = error_line(message * 100)
    assert len(line) <= 1000
    assert "\n" not in line
    assert not any(map(controls_terminal, line))


def test_a_short_message_is_left_alone_and_a_long_one_keeps_both_ends() -> None:
    for message in ("", "--where: expected a value, got 'x' at character 9"):
        assert error_line(message) == message
    line = error_line(f"vessel: got {'y' * 5000}, expected one of a, b")
    assert line.startswith("vessel: got yyy")
    assert line.endswith("y, expected one of a, b")
