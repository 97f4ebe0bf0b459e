def test_none_returns_the_nominal_model(calm, identifier, rng) -> None:
    found = identifier("none").identify(calm.problem, rng)
    assert found.model is calm.problem.nominal
    assert found.residual.terms == ()
