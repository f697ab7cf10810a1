"""Every optimiser pass keeps the values of a program; some keep every bit."""

import itertools
import math
import random
from dataclasses import replace

import mpmath
import pytest
from pfaffian.derive.emit.finiteness import values_to_check
from pfaffian.derive.ir.evaluate import evaluate
from pfaffian.derive.ir.program import Instruction, Op, Program, Signal
from pfaffian.derive.ir.ranges import PLAIN_DOMAINS, plain_calls, ranges
from pfaffian.derive.lower.to_program import lower
from pfaffian.derive.optimise.bake import bake
from pfaffian.derive.optimise.hoist import hoist
from pfaffian.derive.optimise.passes import EMITTED, PASSES, optimise
from pfaffian.derive.optimise.schedule import call_early
from pfaffian.derive.pipeline import derivation_of, library_sets, lowered_model
from pfaffian.derive.spec.library import find_model

MODELS = ("pendubot", "two_wheeled", "pvtol", "chain")
#: Passes that change no bit: what they do is exact in floating point too.
EXACT_PASSES = {"equal values", "signs", "negatives", "comparisons", "signs of parameters"}

_EXACT = {
    Op.ADD: lambda a, b: a + b,
    Op.SUB: lambda a, b: a - b,
    Op.MUL: lambda a, b: a * b,
    Op.DIV: lambda a, b: a / b,
    Op.FMA: lambda a, b, c: a * b + c,
    Op.FMS: lambda a, b, c: a * b - c,
    Op.FNMS: lambda a, b, c: c - a * b,
    Op.NEG: lambda a: -a,
    Op.ABS: abs,
    Op.MIN: min,
    Op.MAX: max,
    Op.SQRT: mpmath.sqrt,
    Op.SIN: mpmath.sin,
    Op.COS: mpmath.cos,
    Op.ATAN: mpmath.atan,
    Op.TANH: mpmath.tanh,
    Op.EXP: mpmath.exp,
    Op.EXPM1: mpmath.expm1,
    Op.LESS: lambda a, b: a < b,
    Op.LESS_EQUAL: lambda a, b: a <= b,
    Op.NOT: lambda a: not a,
    Op.AND: lambda a, b: bool(a) and bool(b),
    Op.OR: lambda a, b: bool(a) or bool(b),
    Op.SELECT: lambda c, a, b: a if c else b,
}


def exactly(program, values):
    """Evaluate `program` at 60 digits: an evaluation that shares nothing with the emitters."""
    with mpmath.workdps(60):
        slots, names = [], iter(program.inputs)
        for i in program.instructions:
            if i.op is Op.INPUT:
                slots.append(mpmath.mpf(values[next(names).name]))
            elif i.op is Op.CONST:
                slots.append(mpmath.mpf(i.value))
            else:
                slots.append(_EXACT[i.op](*(slots[a] for a in i.args)))
        pairs = zip(program.outputs, program.results, strict=True)
        return {s.name: mpmath.mpf(slots[r]) for s, r in pairs}


def drawn(program, parameters, seed):
    """Return values for the inputs of `program`: a set's parameters, and moderate motions."""
    rng = random.Random(seed)
    values = {}
    for s in program.inputs:
        if s.name == "engaged":
            values[s.name] = float(rng.random() < 0.8)
        else:
            values[s.name] = parameters.get(s.name, rng.uniform(0.1, 1.5) * rng.choice((-1, 1)))
    return values


@pytest.fixture(scope="module", params=MODELS)
def raw(request):
    """A model's programs as they were lowered, before any pass, with a parameter set."""
    folder = find_model(request.param)
    derivation = derivation_of(folder)
    programs = {b.name: lower(b) for b in derivation.blocks}
    sets = library_sets(lowered_model(folder), folder)
    return programs, sets[0].as_dict()


def close(one, other):
    return all(abs(one[n] - v) <= mpmath.mpf(10) ** -40 * (1 + abs(v)) for n, v in other.items())


@pytest.mark.parametrize("name", EMITTED)
@pytest.mark.parametrize("title", [title for title, _ in PASSES])
def test_a_pass_keeps_the_values_at_sixty_digits(raw, name, title):
    programs, parameters = raw
    program = programs[name]
    run = dict(PASSES)[title]
    for before, _ in PASSES[: [t for t, _ in PASSES].index(title)]:
        program = dict(PASSES)[before](program)
    done = run(program)
    for seed in range(5):
        values = drawn(program, parameters, seed)
        assert close(exactly(done, values), exactly(program, values))


@pytest.mark.parametrize("title", sorted(EXACT_PASSES))
def test_an_exact_pass_keeps_every_bit(raw, title):
    programs, parameters = raw
    program = programs["step"]
    done = dict(PASSES)[title](program)
    for seed in range(50):
        values = drawn(program, parameters, seed)
        one, other = evaluate(program, values), evaluate(done, values)
        assert {n: v.hex() for n, v in one.items()} == {n: v.hex() for n, v in other.items()}


def test_what_is_prepared_and_reordered_keeps_every_bit(raw):
    programs, parameters = raw
    step, prepare = hoist(programs["step"], programs["prepare"])
    reordered = call_early(step)
    assert len(step.inputs) > len(programs["step"].inputs)
    for seed in range(50):
        values = drawn(programs["step"], parameters, seed)
        prepared = evaluate(prepare, {**values, **parameters})
        fresh = {s.name: prepared[s.name] for s in step.inputs if s.name not in values}
        wanted = evaluate(programs["step"], values)
        for program in (step, reordered):
            found = evaluate(program, {**values, **fresh})
            assert {n: v.hex() for n, v in found.items()} == {n: v.hex() for n, v in wanted.items()}


def test_a_baked_step_keeps_every_bit_and_reads_no_parameter(raw):
    programs, parameters = raw
    optimised = {p.name: p for p in optimise(list(programs.values()))[0]}
    step, prepare = optimised["step"], optimised["prepare"]
    baked = bake(step, prepare, parameters)
    assert not [s for s in baked.step.inputs if s.group == "parameter"]
    constants = dict(baked.constants)
    for seed in range(50):
        values = drawn(step, parameters, seed)
        values |= {n: v for n, v in evaluate(prepare, parameters).items() if n in values}
        inside = {s.name: constants.get(s.name, values.get(s.name, 0.0)) for s in baked.step.inputs}
        one, other = evaluate(step, values), evaluate(baked.step, inside)
        assert {n: v.hex() for n, v in one.items()} == {n: v.hex() for n, v in other.items()}


def test_the_passes_together_save_operations(raw):
    programs, _ = raw
    done, reports = optimise(list(programs.values()))
    sizes = {p.name: sum(p.op_count().values()) for p in done}
    for name in EMITTED:
        assert sizes[name] <= sum(programs[name].op_count().values())
    mine = [r for r in reports if r.program == "step"]
    assert mine[-1].after == sizes["step"] < mine[0].before
    assert all(a.after == b.before for a, b in itertools.pairwise(mine))


def program_of(inputs, instructions, results):
    """Return a small program: inputs by name, then instructions, then which of them leave."""
    signals = tuple(Signal(n, "", "", g) for n, g in inputs)
    head = tuple(Instruction(Op.INPUT, name=n) for n, _ in inputs)
    outputs = tuple(Signal(f"out{k}", "", "", "output") for k in range(len(results)))
    return Program("p", "", signals, (*head, *instructions), outputs, tuple(results))


XY = [("x", "input"), ("y", "input")]


def test_a_finite_sum_vouches_for_its_operands_and_a_comparison_does_not():
    both = program_of(XY, [Instruction(Op.ADD, (0, 1)), Instruction(Op.MUL, (2, 1))], [2, 3])
    assert values_to_check(both) == (3,)
    chosen = program_of(XY, [Instruction(Op.MAX, (0, 1)), Instruction(Op.ADD, (0, 1))], [2, 3])
    assert values_to_check(chosen) == (2, 3)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_every_output_is_finite_where_the_checked_values_are(raw, bad):
    """Put what is not finite into each input in turn: the checks see all that gets out."""
    programs, parameters = raw
    step = {p.name: p for p in optimise(list(programs.values()))[0]}["step"]
    checks = values_to_check(step)
    watched = replace(
        step,
        outputs=tuple(Signal(f"check{k}", "", "", "output") for k in range(len(checks))),
        results=checks,
    )
    limits = ("limit", "threshold")
    for signal in step.inputs:
        if any(word in signal.name for word in limits) or signal.name == "engaged":
            continue  # the limits are looked at on their own
        values = {**drawn(step, parameters, 1), signal.name: bad}
        try:
            found, seen = evaluate(step, values), evaluate(watched, values)
        except (ValueError, OverflowError):
            continue  # Python's sine refuses an infinity where C returns a NaN
        flags = {s.name for s in step.outputs if s.group == "flag"}
        escaped = [n for n, v in found.items() if n not in flags and not math.isfinite(v)]
        assert not escaped or not all(map(math.isfinite, seen.values())), (signal.name, escaped)


def test_ranges_hold_for_random_inputs(raw):
    programs, parameters = raw
    step = {p.name: p for p in optimise(list(programs.values()))[0]}["step"]
    everything = replace(
        step,
        outputs=tuple(Signal(f"v{k}", "", "", "output") for k in range(len(step.instructions))),
        results=tuple(range(len(step.instructions))),
    )
    bounds = {s.name: (-2.0, 2.0) for s in step.inputs if s.group == "input"}
    bounds |= {n: (v, v) for n, v in parameters.items()}
    found = ranges(step, bounds)
    for seed in range(200):
        values = evaluate(everything, drawn(step, parameters, seed))
        for (low, high), value in zip(found, values.values(), strict=True):
            assert low <= value <= high


def test_a_plain_form_is_chosen_only_inside_its_domain():
    root = program_of(XY, [Instruction(Op.FMA, (0, 0, 1)), Instruction(Op.SQRT, (2,))], [3])
    assert plain_calls(root, {"x": (-1e4, 1e4), "y": (1e-30, 1.0)}) == {3}
    assert plain_calls(root, {"x": (-1e4, 1e4), "y": (0.0, 1.0)}) == frozenset()
    assert plain_calls(root, {"x": (-1e30, 1e30), "y": (1e-30, 1.0)}) == frozenset()
    sine = program_of(XY, [Instruction(Op.SIN, (0,))], [2])
    assert plain_calls(sine, {"x": (-1e5, 1e5)}) == {2}
    assert plain_calls(sine, {"x": (-1.0001e5, 1.0)}) == frozenset()
    assert plain_calls(sine, {}) == frozenset()


def test_plain_domains_lie_inside_those_of_the_emitted_functions():
    from pfaffian.derive.elementary.coefficients import SINCOS_MAX

    assert PLAIN_DOMAINS[Op.SIN] == PLAIN_DOMAINS[Op.COS] == (-SINCOS_MAX, SINCOS_MAX)
    least, most = PLAIN_DOMAINS[Op.SQRT]
    assert least >= 2.0**-126
    assert most < 2.0**128


def test_fused_operations_round_once():
    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    program = program_of(
        [("a", "input"), ("b", "input"), ("c", "input")],
        [
            Instruction(Op.FMA, (0, 1, 2)),
            Instruction(Op.FMS, (0, 1, 2)),
            Instruction(Op.FNMS, (0, 1, 2)),
        ],
        [3, 4, 5],
    )
    values = evaluate(program, {"a": a, "b": b, "c": -1.0})
    assert values["out0"] == -(2.0**-60)
    assert values["out1"] == 2.0
    assert values["out2"] == -2.0
    assert evaluate(program, {"a": a, "b": b, "c": 1.0})["out2"] == 2.0**-60
