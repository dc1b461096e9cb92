"""Public functions given wrong arguments: a short attack, and that the attack sees what it is to see."""

import math

import numpy as np
import pytest

import featherstone_gait
from featherstone_gait import search, walking
from featherstone_gait.benchmark.attack_api import _judged, attack_api
from featherstone_gait.benchmark.attack_calls import NO_CALLS, Call, right_calls
from featherstone_gait.identification import fit
from featherstone_gait.run import sensors


@pytest.mark.parametrize("seed", [1, 2])
def test_wrong_arguments_are_refused_by_name(seed):
    assert not attack_api(600, seed, dear=False)


def test_the_same_seed_attacks_the_same(monkeypatch):
    wild = [Call("wild", lambda x: {}[x], {"x": 1.0})]
    monkeypatch.setattr("featherstone_gait.benchmark.attack_api.right_calls", lambda: wild)
    first, again = (attack_api(20, 7) for _ in range(2))
    assert len(first) == 20
    assert first == again


def test_every_public_function_is_attacked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    attacked = {call.name.removeprefix("sensors.") for call in right_calls()}
    names = set(featherstone_gait.__all__) | set(walking.__all__) | set(search.__all__)
    for module in (fit, sensors):
        names |= {n for n, f in vars(module).items() if n[0] != "_" and getattr(f, "__module__", "") == module.__name__}
    assert names - attacked == {name for some in NO_CALLS.values() for name in some}


def test_right_arguments_are_right(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for call in right_calls():
        if not call.dear:
            assert _judged(call, call.arguments, []) is None, call.name


@pytest.mark.long
def test_right_arguments_of_what_takes_long_are_right(tmp_path, monkeypatch):
    """The long attack calls them before it damages them, and would end there."""
    monkeypatch.chdir(tmp_path)
    for call in right_calls():
        if call.dear:
            call.function(**call.arguments)


@pytest.mark.parametrize(
    ("function", "value", "fault"),
    [
        (lambda x: {}[x], 1.0, "KeyError"),
        (lambda x: math.sqrt(x), 1j, "TypeError from inside"),
        (lambda x: np.array([math.nan]), 1.0, "not finite"),
        (lambda x: None, 1j, "accepted"),
    ],
)
def test_faults_are_seen(function, value, fault):
    assert _judged(Call("f", function, {"x": 1.0}), {"x": value}, ["x"])[0] == fault
