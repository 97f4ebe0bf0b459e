"""Names, codes and the kernel of the basis functions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import N_VARIABLES, VARIABLES

NAMES = [name for name in VARIABLES if name != "1"]


@pytest.mark.parametrize(
    ("spelling", "canonical"),
    [
        ("1", "1"),
        ("u_dot", "u_dot"),
        ("v|r|", "|r|v"),
        ("|r|v", "|r|v"),
        ("rrr", "r^3"),
        ("vu", "uv"),
        ("|u||u|", "u^2"),
        ("|v||u|", "|u||v|"),
        ("cos(psi)", "cos(psi)"),
        ("u cos(psi)", "ucos(psi)"),
    ],
)
def test_spellings_of_one_function_have_one_name(spelling: str, canonical: str) -> None:
    assert basis.term(spelling).name == canonical
    assert basis.term(canonical) == basis.term(spelling)


@pytest.mark.parametrize("text", ["", "x", "u^7", "uuuuuuu", "|u", "u_do", "cos(u)", "u+v"])
def test_what_is_no_term_is_refused_by_name(text: str) -> None:
    with pytest.raises(ConfigurationError, match="expected"):
        basis.term(text)


def test_a_repeated_term_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="twice"):
        basis.terms(["v|r|", "|r|v"])


def test_the_full_planar_basis_is_the_31_terms_of_the_thesis() -> None:
    names = [one.name for one in basis.full_basis(("surge", "sway", "yaw"))]
    # Jervan (2020), Table 4.11, in its own order and spelling
    printed = [
        "1", "u_dot", "v_dot", "r_dot", "u", "v", "r", "u|u|", "v|v|", "r|r|", "u^3", "v^3",
        "r^3", "|u|", "|v|", "|r|", "u^2", "v^2", "r^2", "uv", "ur", "vr", "|u|v", "|u|r", "|v|u",
        "|v|r", "|r|u", "|r|v", "|u||v|", "|u||r|", "|v||r|",
    ]  # fmt: skip
    assert names == [basis.term(one).name for one in printed]


def test_orders_are_the_number_of_variables_multiplied() -> None:
    orders = {name: basis.term(name).order for name in ("1", "u_dot", "|u|", "|u|v", "u^3")}
    assert orders == {"1": 0, "u_dot": 1, "|u|": 1, "|u|v": 2, "u^3": 3}


factor = st.tuples(st.sampled_from(NAMES), st.booleans())


@given(
    st.lists(st.lists(factor, min_size=1, max_size=basis.FACTORS), min_size=1, max_size=5),
    st.integers(0, 2**32 - 1),
)
def test_terms_are_the_products_that_their_names_say(
    products: list[list[tuple[str, bool]]], seed: int
) -> None:
    x = np.random.default_rng(seed).normal(size=(5, N_VARIABLES))
    x[:, 0] = 1.0
    speed = np.abs(x[:, [basis.INDEX["U"]]])
    x[:, [basis.INDEX[name] for name in basis.SPEED]] = np.hstack([speed, 1 / speed, speed**-2])
    chosen, expected = [], np.ones((5, len(products)))
    for column, factors in enumerate(products):
        signed = [(name, a and "(" not in name and "/" not in name) for name, a in factors]
        spelled = [f"|{name}|" if a else name.removeprefix("1") for name, a in signed]
        chosen.append(basis.term("".join(spelled)))
        for name, magnitude in signed:
            value = x[:, VARIABLES.index(name)]
            expected[:, column] *= np.abs(value) if magnitude else value
    np.testing.assert_allclose(basis.evaluate(chosen, x), expected, rtol=1e-13)
    assert [basis.term(one.name) for one in chosen] == chosen


def test_variables_stand_where_their_names_say() -> None:
    nu_dot, nu = np.array([[1.0, 2.0, 3.0]]), np.array([[4.0, 5.0, 6.0]])
    x = basis.variables(nu_dot, nu, np.array([[0.1, 0.2, 0.3]]), ("surge", "sway", "yaw"))[0]
    named = dict(zip(VARIABLES, x, strict=True))
    assert (named["u_dot"], named["v_dot"], named["r_dot"]) == (1.0, 2.0, 3.0)
    assert (named["u"], named["v"], named["r"], named["w"]) == (4.0, 5.0, 6.0, 0.0)
    assert named["cos(psi)"] == pytest.approx(np.cos(0.3))
    assert named["sin(phi)"] == pytest.approx(np.sin(0.1))
    assert named["1"] == 1.0
