"""Frama-C Eva proves the complete controller: no run-time error from any bits, and its torque.

Every byte of memory, parameters and inputs is arbitrary. `make prove` sets PFAFFIAN_PROVE_ALL, for
what takes long.
"""

import os
import shutil

import pytest
from pfaffian.runtime.code.generated_model import open_generated
from support_eva_control import SENSING, SUPERVISOR, Limits, control_driver, prove_any, prove_step

needs_eva = pytest.mark.skipif(
    not shutil.which("frama-c"), reason="needs frama-c: apt-get install frama-c-base"
)
is_long = pytest.mark.skipif(
    not os.environ.get("PFAFFIAN_PROVE_ALL"), reason="takes minutes: make prove"
)
CODE = open_generated("pendubot")


def assert_proved(verdict, least):
    assert verdict.alarms == 0, verdict.said
    assert verdict.unproved == 0, verdict.said
    assert verdict.proved >= least


@needs_eva
def test_the_supervisor_is_consistent_and_has_no_alarm_from_any_bits(tmp_path):
    """Step, log, trip and init; a torque is allowed in SWING_UP and BALANCE only."""
    assert_proved(prove_any(CODE, SUPERVISOR, tmp_path, ["pf_supervisor.c"]), 8)


@needs_eva
def test_the_sensing_has_no_alarm_from_any_bits(tmp_path):
    """After init, within the bounds of offset and counts, the first outputs are finite."""
    assert_proved(prove_any(CODE, SENSING, tmp_path, ["pf_sensing.c"]), 5)


@needs_eva
def test_the_control_step_has_no_alarm_from_any_bits_and_keeps_its_limit(tmp_path):
    """Memory need not be sealed, nor be what init makes; the limit is the rig's."""
    assert_proved(prove_any(CODE, control_driver(CODE.manifest, Limits(2.0), False), tmp_path), 15)


@is_long
@needs_eva
@pytest.mark.parametrize("init", [False, True], ids=["any memory", "after init"])
@pytest.mark.parametrize("limit", [None, 1e300, 5e-324])
def test_other_limits_hold_and_any_bits_of_one_give_a_finite_torque(limit, init, tmp_path):
    assert_proved(prove_any(CODE, control_driver(CODE.manifest, Limits(limit), init), tmp_path), 15)


@needs_eva
@pytest.mark.parametrize(
    "model",
    [
        *("chain", "pendubot", "pvtol"),
        *(
            pytest.param(m, marks=is_long)
            for m in ("acrobot", "cart_pole", "crane", "furuta", "reaction_wheel", "tora")
        ),
        pytest.param("two_wheeled", marks=is_long),
    ],
)
def test_a_step_of_the_law_has_no_alarm_from_any_bits(model, tmp_path):
    """Memory, parameters and measurements; that the torque is limited is proved elsewhere."""
    assert_proved(prove_step(open_generated(model), tmp_path), 10)


#: By the driver that finds it: file, before, after.
FAULTS = {
    "the log's index not wrapped": (
        "supervisor",
        (
            "pf_supervisor.c",
            "&state->log[state->logged % PF_LOG_LENGTH]",
            "&state->log[state->logged]",
        ),
    ),
    "a mode that is believed": (
        "supervisor",
        ("pf_supervisor.c", "        && (state->mode <= (uint32_t)PF_MODE_FAULT)\n", ""),
    ),
    "a torque allowed in FAULT": (
        "supervisor",
        (
            "pf_supervisor.c",
            "? 1U : 0U;\n}\n\nvoid pf_supervisor_step",
            "? 1U : 1U;\n}\n\nvoid pf_supervisor_step",
        ),
    ),
    "a shift by any number of bits": (
        "sensing",
        ("pf_sensing.c", "(params->counter_bits < 8U) || ", ""),
    ),
    "a count that may overflow": (
        "sensing",
        (
            "pf_sensing.c",
            "(state->count <= LARGEST_COUNT) && (state->count >= -LARGEST_COUNT)",
            "1",
        ),
    ),
}
LONG_FAULTS = {
    "a limit left out": (
        "pendubot_control.c",
        "pf_slewed(demand.tau, state->tau_applied,\n"
        "            params->law.slew_limit * params->law.sample_time, params->law.torque_limit)",
        "demand.tau",
    ),
    "a plan read beyond its end": (
        "pendubot_plan.c",
        "    if (!(time < plan->end_time)) {",
        "    if (0) {",
    ),
    "a torque whatever the mode": (
        "pendubot_control.c",
        "output->tau = (verdict.torque_allowed == 1U)",
        "output->tau = (verdict.mode <= 3U)",
    ),
}
DRIVERS = {"supervisor": SUPERVISOR, "sensing": SENSING}


def is_noticed(verdict):
    return verdict.alarms + verdict.unproved > 0


@needs_eva
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_a_module_is_not_proved_away(fault, tmp_path):
    module, spoil = FAULTS[fault]
    found = prove_any(CODE, DRIVERS[module], tmp_path, [f"pf_{module}.c"], spoil)
    assert is_noticed(found)


@is_long
@needs_eva
@pytest.mark.parametrize("fault", LONG_FAULTS)
def test_a_fault_in_the_control_step_is_not_proved_away(fault, tmp_path):
    text = control_driver(CODE.manifest, Limits(2.0), False)
    assert is_noticed(prove_any(CODE, text, tmp_path, (), LONG_FAULTS[fault]))
