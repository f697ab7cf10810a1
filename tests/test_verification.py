"""The verification itself: it passes on what is generated, and fails on what is wrong."""

import shutil

import mpmath
import numpy as np
import pytest
from conftest import THOROUGH
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.spec.library import find_model
from pfaffian.derive.verify.compare import FUNCTIONS, LIMIT_ULP, verify
from pfaffian.derive.verify.condition import Condition
from pfaffian.derive.verify.oracle import Oracle
from pfaffian.derive.verify.sampling import draw
from pfaffian.derive.verify.subjects import CompiledUnderTest, PythonUnderTest
from pfaffian.derive.verify.ulp_unit import DOUBLE_UNIT
from pfaffian.runtime.code.generated_model import host_model, open_generated, ppc750_model


@pytest.fixture(scope="module")
def source():
    folder = find_model("pendubot")
    model = lowered_model(folder)
    return derivation_of(folder), model, [s.as_dict() for s in library_sets(model, folder)]


@pytest.fixture(scope="module")
def code():
    return open_generated("pendubot")


@pytest.mark.target
def test_generated_code_in_every_language_is_within_the_limit_and_the_target_has_the_same_bits(
    source, code
):
    subjects = [PythonUnderTest(code), CompiledUnderTest(host_model(code), "c-host")]
    target = CompiledUnderTest(ppc750_model(code), "c-ppc750")
    found = verify(*source, subjects, target, samples=1500, target_samples=1500)
    assert found.passed
    assert found.worst_scaled_ulp <= LIMIT_ULP
    assert found.target_samples == 1500
    assert found.target_mismatches == 0
    assert {(r.function, r.language) for r in found.functions} == {
        (f, language) for f in FUNCTIONS for language in ("python", "c-host", "c-ppc750")
    }
    assert 0.1 < found.branches["saturated"] < 0.9
    assert 0.02 < found.branches["near_singular"] < 0.9


#: A slip in the generated C, and the function it must be caught in.
SLIPS = {
    "a wrong sign": ("pendubot.c", "const double beta = offset + s;", "beta = offset - s;"),
    "a lost term": ("pendubot.c", "layer + kappa", "layer"),
    "single precision": ("pendubot.c", "3.141592653589793", "3.14159274"),
    "a plant slip": ("pendubot_plant.c", "theta1 + theta2)", "theta1 - theta2)"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_in_the_generated_code_is_caught(slip, source, code, tmp_path):
    file, right, wrong = SLIPS[slip]
    wrong = wrong if wrong.startswith(("layer", "3.", "theta")) else f"const double {wrong}"
    folder = tmp_path / "pendubot"
    shutil.copytree(code.path, folder)
    path = folder / "c" / file
    text = path.read_text()
    assert right in text
    path.write_text(text.replace(right, wrong))
    subject = CompiledUnderTest(host_model(open_generated(str(folder))), "c-host")
    found = verify(*source, [subject], None, samples=300, target_samples=0)
    assert not found.passed


def test_one_differing_bit_on_the_target_is_a_mismatch(source, code):
    class Flipped(CompiledUnderTest):
        def evaluate(self, function, values):
            outputs = super().evaluate(function, values)
            if function == "step":
                outputs["tau"].view(np.uint64)[3] ^= np.uint64(1)
            return outputs

    host = host_model(code)
    subjects = [CompiledUnderTest(host, "c-host")]
    found = verify(*source, subjects, Flipped(host, "flipped"), samples=50, target_samples=50)
    assert found.target_mismatches == 1
    assert not found.passed


def test_the_oracle_agrees_with_mpmath_at_fifty_digits(source):
    """The MPFR oracle against mpmath on SymPy's fully expanded expression: other arithmetic."""
    derivation, model, sets = source
    block = derivation.block("continuous")
    values = draw(model, block.inputs, sets, 5, np.random.default_rng(4)).values
    oracle = Oracle(block)
    for k in range(5 if THOROUGH else 2):
        point = {n: float(v[k]) for n, v in values.items()}
        outputs, _ = oracle(point)
        exact = {s: mpmath.mpf(point[s.name]) for s in block.symbols}
        for symbol, value in zip(block.results[:7], outputs[:7], strict=True):
            with mpmath.workdps(60):
                wanted = block.expanded(symbol).evalf(55, subs=exact, maxn=400)
                relative = abs(mpmath.mpf(str(value)) / mpmath.mpf(str(wanted)) - 1)
            assert relative < mpmath.mpf(10) ** -45, symbol


def test_the_condition_scale_is_the_effect_of_rounding_the_inputs(source):
    """By finite differences: nudging every input moves no output further than the scale says."""
    derivation, model, sets = source
    block = derivation.block("continuous")
    program = model.program("continuous")
    rng = np.random.default_rng(5)
    values = draw(model, block.inputs, sets, 200, rng).values
    near = np.flatnonzero((np.abs(values["q1"]) < 20.0) & (np.abs(values["q2"]) < 20.0))[:40]
    assert len(near) == 40  # far angles: a relative step turns the links too far to be linear
    values = {n: v[near] for n, v in values.items()}
    named, by_input = Condition(block)(values)
    relative = 1e-7
    for k in range(40):
        point = {n: float(v[k]) for n, v in values.items()}
        here = evaluate(program, point)
        total = dict.fromkeys(here, 0.0)
        for name, value in point.items():
            moved = evaluate(program, {**point, name: value * (1 + relative)})
            for output, y in here.items():
                total[output] += abs(moved[output] - y) / relative
        for output in ("p1", "beta", "adb", "s"):
            assert by_input[output][k] == pytest.approx(total[output], rel=0.02)
            assert named[output][k] >= by_input[output][k]


def test_every_sample_has_a_positive_definite_mass_matrix(source):
    _, model, sets = source
    inputs = model.program("step").inputs
    values = draw(model, inputs, sets, 2000, np.random.default_rng(6)).values
    t1, t2, t3 = (values[f"theta{k}"] for k in (1, 2, 3))
    assert (t1 * t2 - (t3 * np.cos(values["q2"])) ** 2 > 0.0).all()
    for c in model.coordinates:
        assert np.abs(values[c.name]).max() <= c.bound
        assert np.abs(values[c.name]).max() > 0.9 * c.bound


def test_a_comparison_within_the_rounding_of_its_sides_is_left_undecided():
    """The torque of this two-wheeled robot cancels down to its limit: either branch is right."""
    robot = find_model("two_wheeled")
    block = derivation_of(robot).block("step")
    at = {
        "phi": -8262.330462763573, "psi": -396.1854559504574, "dphi": -936.1538408804115,
        "dpsi": -630.5234920443581, "engaged": 1.0, "constraint_offset": -16.589292827618497,
        "drift_previous": 1.926528455215355e-06, "bound_estimate": 0.01865040213730726,
        "leakage_decay": 0.9103904061244579, "adaptation_step": 0.00866056876439407,
        "wheel_mass": 0.030870840404089987, "radius": 1.863198562006751e-06,
        "wheel_inertia": 0.00011293056162149922, "body_mass": 1.264462020632877e-06,
        "height": 0.0003096850198040675, "body_inertia": 7.967035767022973e-06,
        "rotor_inertia": 3766.8498024244836, "gear": 8276.54304776162, "g": 1.4652999388083627,
        "weight_phi": -7197.189719567613, "rate_phi": 1.3435952595302438e-05,
        "rate_psi": 8.90427926093584, "sigma": 14802.636115554656, "eta": 3.1450129942278426,
        "kappa": 0.05343286849312817, "epsilon": 0.07912999231617145,
        "sample_time": 0.0002933932989054527, "torque_limit": 0.0003141966659317948,
        "singular_threshold": 2.4083402716537086e-06, "phid": -0.00015848577808362638,
        "psid": 0.15268433025327877,
    }  # fmt: skip
    ordinary = dict.fromkeys(at, 0.1) | library_sets(lowered_model(robot), robot)[0].as_dict()
    both = {n: np.array([at[n], ordinary[n]]) for n in at}
    close = Condition(block).close_calls(both, LIMIT_ULP * 2.0**-DOUBLE_UNIT.digits)
    assert close.tolist() == [True, False]
