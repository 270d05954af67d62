"""Rendering without a display."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from musebot.models import arena_spec
from musebot.protocols.errors import InputError
from musebot.protocols.pages.offscreen import Canvas


def test_without_egl_the_sentence_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(InputError, match="apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"):
        Canvas(arena_spec().compile(), "overhead", 64, 48)


def test_module_prints_the_renderer_and_the_time_of_an_image(egl):
    command = [sys.executable, "-m", "musebot.protocols.pages.offscreen"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["renderer"]
    assert found["ms"] > 0
