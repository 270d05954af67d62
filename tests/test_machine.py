"""Cores and memory of a container, from files in the place of the system's."""

import os

from musebot.protocols import machine


def test_a_container_has_the_cores_and_the_memory_of_its_limits(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "Path", lambda _, name: tmp_path / name)
    monkeypatch.setattr(machine.sys, "platform", "linux")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: range(8), raising=False)
    total = machine.machine_bytes()
    assert machine.cores() == 8
    for name, text, cores, memory in (
        ("cpu.max", "1000 100000", 1, total),
        ("cpu.max", "250000 100000", 3, total),  # two and a half cores
        ("cpu.max", "900000 100000", 8, total),
        ("cpu.max", "max 100000", 8, total),
        ("memory.max", "1048576", 8, 2**20),
        ("memory.max", "max", 8, total),
    ):
        (tmp_path / name).write_text(f"{text}\n")
        assert (machine.cores(), machine.machine_bytes()) == (cores, memory)
