from dataclasses import replace

import numpy as np
import pytest

from service.drivers.ur.gate import UNSAFE, Facts, Verdict, failures, judge
from tests.service.drivers.ur.cells import UR, ur_config
from tests.service.drivers.ur.test_samples import package

CONFIG = ur_config(ur={"model": "UR3", "serial": "20235300042"})


def good_facts() -> Facts:
    noise = np.random.default_rng(0).normal(0.0, 0.5, (100, 6)) * [1, 1, 1, 0.1, 0.1, 0.1]
    ready = package(payload_kg=UR["payload_kg"], payload_com=UR["payload_com_m"], tcp_offset=UR["tcp_m"])
    return Facts(
        version=(5, 21, 3),
        model="UR3",
        serial="20235300042",
        remote_control=True,
        package=ready,
        configured=ready,
        wrenches=noise + np.array([2.0, 0, 0, 0, 0, 0]),
        round_trip_s=0.006,
        watchdog_s=0.11,
    )


def verdicts(facts: Facts) -> dict[str, Verdict]:
    return {check.name: check.verdict for check in judge(facts, CONFIG.ur, CONFIG.preflight)}


def test_a_controller_as_it_should_be_passes_every_check() -> None:
    assert set(verdicts(good_facts()).values()) == {Verdict.PASSED}


@pytest.mark.parametrize(
    ("name", "changes", "package_changes"),
    [
        ("PolyScope", {"version": (5, 9, 4)}, {}),
        ("PolyScope", {"version": (10, 1, 0)}, {}),
        ("robot", {"model": "UR10"}, {}),
        ("robot", {"serial": "20235300043"}, {}),
        ("remote control", {"remote_control": False}, {}),
        ("safety mode", {}, {"safety_mode": 3}),
        ("robot mode", {}, {"robot_mode": 5}),
        ("speed slider", {}, {"speed_fraction": 0.5}),
        ("registers", {"round_trip_s": 0.5}, {}),
        ("registers", {"round_trip_s": float("inf")}, {}),
        ("payload", {}, {"payload_kg": 0.83}),
        ("payload", {}, {"payload_com": (0.0, 0.0, 0.02)}),
        ("TCP", {}, {"tcp_offset": (0.0, 0.0, 0.18, 0.0, 0.0, 0.0)}),
        ("TCP", {}, {"tcp_offset": (0.0, 0.0, 0.19, 0.0, 0.1, 0.0)}),
        ("watchdog", {"watchdog_s": 0.9}, {}),
        ("watchdog", {"watchdog_s": float("inf")}, {}),
        ("F/T load", {"wrenches": good_facts().wrenches + np.array([0, 0, 13.0, 0, 0, 0])}, {}),
        ("F/T noise", {"wrenches": good_facts().wrenches * 5.0}, {}),
        ("F/T noise", {"wrenches": np.ones((100, 6))}, {}),
        ("F/T load", {"wrenches": good_facts().wrenches * float("nan")}, {}),
    ],
)
def test_what_is_wrong_fails_its_check_and_says_what_to_do(name, changes, package_changes) -> None:
    facts = good_facts()
    spoilt = facts.package._replace(**package_changes)
    facts = replace(facts, package=spoilt, configured=spoilt, **changes)
    failed = failures(judge(facts, CONFIG.ur, CONFIG.preflight))
    assert name in [check.name for check in failed]
    assert all(check.remedy and check.measured for check in failed)


def test_polyscope_x_is_refused_by_its_name_though_it_answers_no_dashboard() -> None:
    (failed,) = failures(judge(Facts(version=(10, 7, 0)), CONFIG.ur, CONFIG.preflight))
    assert failed.name in UNSAFE
    assert "PolyScope: X, 10.7.0" in failed.text
    assert "use a controller with PolyScope 5" in failed.text


def test_a_robot_that_the_configuration_does_not_name_may_be_any() -> None:
    config = ur_config()
    assert failures(judge(good_facts(), config.ur, config.preflight)) == ()


def test_what_was_not_measured_is_not_passed() -> None:
    assert set(verdicts(Facts()).values()) == {Verdict.SKIPPED}
    assert verdicts(replace(good_facts(), watchdog_s=None))["watchdog"] is Verdict.SKIPPED


def test_the_checks_that_forbid_a_connection_exist() -> None:
    assert set(verdicts(good_facts())) >= UNSAFE
