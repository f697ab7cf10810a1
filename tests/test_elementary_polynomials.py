"""The polynomials as they are emitted have the error that is recorded of them."""

import mpmath
import pytest
from conftest import REPOSITORY
from pfaffian.derive.elementary.coefficients import elementary_coefficients, render_context
from pfaffian.derive.elementary.single import single_coefficients, single_render_context
from pfaffian.derive.elementary.tables import atan_reach, sincos_reach

#: The formula of each polynomial p, what it stands for, its range and where it is relative to.
FORMULAS = {
    "sin": (lambda r, p: r + r**3 * p(r * r), mpmath.sin, sincos_reach, False),
    "versine": (lambda r, p: 1 - r**2 * p(r * r), mpmath.cos, sincos_reach, False),
    "atan": (lambda t, p: t + t**3 * p(t * t), mpmath.atan, atan_reach, False),
    "exp": (lambda r, p: r + r**2 * p(r), mpmath.expm1, lambda: mpmath.log(2) / 2, True),
}
GRID = 701


def emitted(context, name):
    """Return the coefficients from the constant term up, as the template writes them."""
    poly = context[name]
    return [float.fromhex(t["c"].rstrip("f")) for t in (poly["first"], *poly["rest"])][::-1]


def worst(name, coefficients, slack):
    formula, exact, reach, both = FORMULAS[name]
    with mpmath.workdps(50):
        top = mpmath.mpf(reach()) * slack
        points = [top * k / GRID for k in range(-GRID if both else 1, GRID + 1) if k]

        def polynomial(z):
            return mpmath.fsum(c * z**k for k, c in enumerate(coefficients))

        return float(max(abs(formula(x, polynomial) / exact(x) - 1) for x in points))


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_emitted_coefficients_have_the_recorded_error(precision, name):
    single = precision == "single"
    context = single_render_context() if single else render_context()
    recorded = (single_coefficients() if single else elementary_coefficients()).__dict__[name]
    found = emitted(context, name)
    assert found == list(recorded.coefficients)
    error = worst(name, found, 1 + 2.0**-10 if single else 1)
    assert error <= 1.05 * recorded.error
    assert recorded.error <= 1.05 * error


@pytest.mark.parametrize("name", FORMULAS)
def test_the_generated_table_holds_the_coefficients_whose_error_its_header_states(name):
    folder = REPOSITORY / "generated" / "pendubot" / "c"
    table = (folder / "pf_elementary.c").read_text(encoding="utf-8")
    header = (folder / "pf_elementary_inline.h").read_text(encoding="utf-8")
    if name == "exp":
        header = table + header
    poly = render_context()[name]
    for term in (poly["first"], *poly["rest"]):
        assert term["c"] in table + header
    stated = float(mpmath.log(worst(name, emitted(render_context(), name), 1), 2))
    assert poly["error"].startswith("2^")
    assert abs(float(poly["error"][2:]) - stated) < 0.15
    assert poly["error"] in table + header
