"""A brain on another device: a step copies nothing to or from the host, and mixes no devices.

The device "meta" has shapes but no numbers: reading a number on the host fails there, and so does
an operation on tensors of two devices. So these tests need no GPU.
"""

import pytest
import torch

from musebot.controller import BRAINS, Neurocontroller, Parameters
from musebot.controller.senses import Senses, Signal

SENSES = Senses((Signal(0.0, 1.0, 10.0), Signal(-1.0, 1.0)), Signal(0.0, 1.0, 10.0))
ROBOTS = 3
WAYS = {n: (BRAINS[n], "creative") for n in ("paper", "steady", "steady-adam", "recurrent")}
WAYS |= {f"{n}-{p}": (BRAINS[n], p) for n in ("paper", "steady") for p in ("fixed", "random")}
WAYS["held-noise"] = Parameters(noise_steps=10), "creative"
WAYS["noise-for-life"] = Parameters(noise_steps=0, test_epsilon=0.1), "creative"


class HostGenerator(torch.Generator):
    """There is no generator of random numbers on "meta"; one of the host serves."""

    def __new__(cls, device):
        del device
        return super().__new__(cls)


@pytest.fixture
def on_meta(monkeypatch):
    monkeypatch.setattr(torch, "Generator", HostGenerator)


@pytest.mark.parametrize("way", WAYS)
@torch.inference_mode()
def test_a_step_reads_no_number_on_the_host(way, on_meta):
    parameters, proposer = WAYS[way]
    with torch.device("meta"):
        brain = Neurocontroller(parameters, proposer, ROBOTS, SENSES, 1)
    signals = torch.zeros(ROBOTS, 2, device="meta")
    for explore in (True, True, False, True):
        motors = brain.act(signals, explore)
        assert motors.device.type == "meta" and motors.shape == (ROBOTS, 2)
        if explore:
            brain.learn(signals[:, 0])
    brain.forget_step()
    brain.act(signals, True)
    brain.learn(signals[:, 0])


@pytest.mark.parametrize("wrong", [int, bool, torch.ones(1).add])
def test_reading_a_number_or_mixing_devices_fails_on_meta(wrong):
    with pytest.raises(RuntimeError):
        wrong(torch.zeros(1, device="meta"))


def test_all_state_but_the_counters_is_on_the_device(on_meta):
    with torch.device("meta"):
        brain = Neurocontroller(BRAINS["recurrent"], "creative", ROBOTS, SENSES, 1)
    here = {n for n, tensor in brain.state().items() if tensor.device.type == "cpu"}
    assert here == {"age", "noise.age", "generator"}


def test_a_state_of_the_host_is_loaded_onto_the_device(on_meta):
    parameters = BRAINS["steady"]
    host = Neurocontroller(parameters, "creative", ROBOTS, SENSES, 1)
    for _ in range(3):
        host.act(torch.zeros(ROBOTS, 2), True)
        host.learn(torch.zeros(ROBOTS))
    with torch.device("meta"):
        brain = Neurocontroller(parameters, "creative", ROBOTS, SENSES, 1)
    brain.load_state(host.state())
    brain.act(torch.zeros(ROBOTS, 2, device="meta"), True)
    brain.learn(torch.zeros(ROBOTS, device="meta"))
    assert int(brain.state()["age"]) == 4
