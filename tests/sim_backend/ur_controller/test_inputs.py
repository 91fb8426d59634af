"""Inputs that a client writes, and the watchdog over them."""

import numpy as np
import pytest

from sim_backend.ur_controller import events
from wire.plant import PlantErrors
from wire.rtde.modes import RuntimeState
from wire.task import Task

COUNT = "n = 0\nwhile True:\n  n = n + 1\n  write_output_integer_register(24, n)\n  sync()\nend"


def test_what_a_client_writes_takes_effect_with_the_latency_of_the_episode(bench):
    delay = bench.plant.input_delay
    assert delay == 2
    bench.controller.apply_inputs(("input_int_register_24", "input_double_register_47"), (5, 2.5))
    bench.run(delay)
    assert bench.get("input_int_register_24") == 0
    bench.run(1)
    assert (bench.get("input_int_register_24"), bench.get("input_double_register_47")) == (5, 2.5)


def test_every_input_reaches_what_it_is_for(bench):
    names = {
        "input_bit_registers0_to_31": 1 << 31 | 1,
        "input_bit_register_64": True,
        "speed_slider_mask": 1,
        "speed_slider_fraction": 0.25,
        "standard_digital_output_mask": 0b110,
        "standard_digital_output": 0b011,
        "configurable_digital_output_mask": 1,
        "configurable_digital_output": 1,
        "tool_digital_output_mask": 2,
        "tool_digital_output": 2,
        "standard_analog_output_mask": 0b11,
        "standard_analog_output_type": 0b10,
        "standard_analog_output_0": 0.5,
        "standard_analog_output_1": float("nan"),
    }
    bench.controller.apply_inputs(tuple(names), tuple(names.values()))
    bench.run(3)
    assert bench.get("input_bit_registers0_to_31") == 1 << 31 | 1
    assert bench.get("input_bit_register_64") is True
    assert bench.get("target_speed_fraction") == 0.25
    assert bench.get("actual_digital_output_bits") == 0b10 | 1 << 8 | 1 << 17
    assert bench.get("standard_analog_output0") == pytest.approx(0.012)
    assert bench.get("standard_analog_output1") == 0.0
    assert bench.get("analog_io_types") >> 2 == 0b10
    # a value without its mask counts for nothing
    bench.controller.apply_inputs(("standard_digital_output",), (0xFF,))
    bench.run(3)
    assert bench.get("actual_digital_output_bits") == 0b10 | 1 << 8 | 1 << 17


@pytest.mark.parametrize(
    "call",
    [
        "movej([x,0,0,0,0,0])",
        "movel(p[x,0,0,0,0,0])",
        "servoj([0,0,0,0,0,x])",
        "speedj([0,0,0,0,0,x], 1, 0.1)",
        "speedl([x,0,0,0,0,0], 1, 0.1)",
        "speedl([0.01,0,0,0,0,0], x, 0.1)",
        "force_mode(p[x,0,0,0,0,0], [0,0,1,0,0,0], [0,0,x,0,0,0], 2, [1,1,1,1,1,1])\nsleep(0.1)",
        "set_tcp(p[0,0,x,0,0,0])",
        "set_payload(1.0, [0,0,x])",
    ],
)
def test_what_is_no_number_never_reaches_the_arm(bench, call):
    bench.run(10)
    stood = bench.plant.q
    bench.controller.apply_inputs(("input_double_register_24",), (float("nan"),))
    bench.run(3)
    bench.program(f"x = read_input_float_register(24)\n{call}")
    bench.run(100)
    assert bench.plant.q == pytest.approx(stood, abs=2e-3)
    assert np.isfinite(bench.plant.wrench).all()
    assert bench.of(events.RuntimeFailed) or not bench.controller.safety.may_move


def test_a_flood_of_packages_keeps_memory_bounded_and_the_newest_wins(bench):
    for value in range(5000):
        bench.controller.apply_inputs(("input_int_register_0",), (value,))
    bench.run(4)
    assert bench.get("input_int_register_0") == 4999


def feed(bench, ticks, every=1):
    for tick in range(ticks):
        if tick % every == 0:
            bench.controller.apply_inputs(("input_int_register_24",), (1,))
        bench.run(1)


@pytest.mark.parametrize(
    ("action", "state"),
    [("stop", RuntimeState.STOPPED), ("pause", RuntimeState.PAUSED), ("ignore", RuntimeState.PLAYING)],
)
def test_a_watchdog_acts_when_packages_stop_coming_and_not_before(bench, action, state):
    bench.program(f'rtde_set_watchdog("input_int_register_24", 50, "{action}")\n{COUNT}')
    feed(bench, 101, every=10)
    assert bench.controller.runtime_state is RuntimeState.PLAYING
    bench.run(10)
    assert bench.controller.runtime_state is RuntimeState.PLAYING
    bench.run(80)
    assert bench.controller.runtime_state is state


def test_a_moving_arm_comes_to_rest_by_its_watchdog(bench):
    bench.program('rtde_set_watchdog("input_int_register_24", 25, "stop")\nspeedj([0,0,0,0,0,0.5], 5, 10)')
    feed(bench, 200)
    assert bench.plant.qd[5] == pytest.approx(0.5, abs=0.02)
    bench.run(100)
    assert np.abs(bench.plant.qd).max() < 1e-2
    assert bench.controller.runtime_state is RuntimeState.STOPPED


def test_a_watchdog_ends_with_its_program(bench):
    bench.program('rtde_set_watchdog("input_int_register_24", 500, "stop")\nsync()')
    bench.run(3)
    bench.heard.clear()
    bench.program(COUNT)
    bench.run(50)
    assert bench.controller.runtime_state is RuntimeState.PLAYING


@pytest.mark.parametrize(
    "call", ['rtde_set_watchdog("actual_q", 10)', 'rtde_set_watchdog("input_int_register_24", 10, "explode")']
)
def test_a_watchdog_that_cannot_be_is_an_error_of_the_program(bench, call):
    bench.program(call)
    bench.run(2)
    assert bench.of(events.RuntimeFailed)


def test_the_latency_of_what_a_client_writes_varies_with_the_plant(bench):
    bench.plant.lay_out(Task(0, plant=PlantErrors(target_delay_ticks=3, target_jitter_ticks=4)))
    taken = []
    for value in range(1, 40):
        bench.controller.apply_inputs(("input_int_register_24",), (value,))
        ticks = 0
        while bench.get("input_int_register_24") != value:
            bench.run(1)
            ticks += 1
        taken.append(ticks - 1)
    assert set(taken) == set(range(5, 10))
