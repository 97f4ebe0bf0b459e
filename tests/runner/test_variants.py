"""Options that a choice does not have, and options that change together, in a sweep."""

from tests.runner.command import Command


def trials(seatrial: Command, *arguments: str) -> list[str]:
    """The trials of a dry run, as their overrides."""
    answer = seatrial("-m", *arguments, "evaluation=none", "dry_run=true")
    assert answer.code == 0, answer.err
    lines = [line for line in answer.out.splitlines() if line.startswith("new ")]
    return [" ".join(line.split()[1:]).replace(" evaluation=none", "") for line in lines]


def test_an_option_is_left_out_where_a_choice_does_not_have_it(seatrial: Command) -> None:
    assert trials(seatrial, "identifier=none,ls", "identifier.basis=physical,full") == [
        "identifier=none",
        "identifier=ls identifier.basis=physical",
        "identifier=ls identifier.basis=full",
    ]
    # nor does the default
    seeds = ("identifier=none,plsr", "identifier.bootstrap=null", "seed=1,2")
    assert trials(seatrial, *seeds) == [
        "identifier=none seed=1",
        "identifier=none seed=2",
        "identifier.bootstrap=null identifier=plsr seed=1",
        "identifier.bootstrap=null identifier=plsr seed=2",
    ]


def test_an_option_that_no_choice_has_is_refused(seatrial: Command) -> None:
    said = seatrial.refuses("-m", "identifier=none,ls", "identifier.bases=physical")
    assert "identifier.bases" in said
    said = seatrial.refuses("-m", "identifier=none", "identifier.basis=physical", "seed=1,2")
    assert "basis" in said


def test_variants_change_options_together(seatrial: Command) -> None:
    variants = ("--variant", "identifier=ls identifier.basis=physical", "--variant=identifier=none")
    assert trials(seatrial, *variants, "seed=1,2") == [
        "identifier=ls identifier.basis=physical seed=1",
        "identifier=ls identifier.basis=physical seed=2",
        "identifier=none seed=1",
        "identifier=none seed=2",
    ]
    assert trials(seatrial, "--variant", "identifier=ls,none disturbance='[wind,noise]'") == [
        "identifier=ls disturbance=[wind,noise]",
        "identifier=none disturbance=[wind,noise]",
    ]


def test_a_wrong_variant_is_refused(seatrial: Command) -> None:
    for arguments, message in (
        (["-m", "--variant"], "--variant: got '', expected overrides such as"),
        (["-m", "--variant", "identifier"], "--variant: got 'identifier', expected overrides"),
        (["-m", "--variant", "identifier='ls"], '--variant: got "identifier=\'ls": No closing'),
        (["--variant", "identifier=ls"], "--variant: got one trial, expected a sweep (-m)"),
    ):
        assert seatrial.refuses(*arguments).startswith(message)
