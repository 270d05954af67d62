"""The wheel: what it holds, and what works where only the wheel and some extras are installed."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from musebot.protocols.errors import missing_extra

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FOLDERS = ("models", "tasks", "controller", "protocols")
README = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
# What only the extras `brain`, `baselines` and `cluster` install.
# README's code renders a picture; the other tests switch OpenGL off.
DRAWING = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
HIDDEN = "torch safetensors matplotlib jinja2 tyro rich ray stable_baselines3"

# Runs all blocks in one process, each with names of its own.
RUN_BLOCKS = """
import json, sys
import musebot
for block in json.load(sys.stdin):
    exec(block, {"__name__": "block"})
assert sys.modules.get("torch") is None
print(musebot.__file__)
"""


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    """Path of a wheel that is built as `make dist` builds it."""
    folder = tmp_path_factory.mktemp("build")
    skipped = shutil.ignore_patterns(".*", "docs", "runs", "build", "dist", "tests", "__pycache__")
    shutil.copytree(ROOT, folder / "any-name", ignore=skipped)
    code = "from setuptools import build_meta; print(build_meta.build_wheel('..'))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder / "any-name", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / done.stdout.splitlines()[-1]


@pytest.fixture(scope="session")
def gym_only(wheel, tmp_path_factory):
    """Python with the wheel, and of this environment's packages all that `gym` installs.

    The packages in the variable HIDDEN cannot be imported.
    """
    folder = tmp_path_factory.mktemp("gym")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    with zipfile.ZipFile(wheel) as files:
        files.extractall(site)
    shared = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    (site / "shared.pth").write_text("\n".join(shared))
    (site / "sitecustomize.py").write_text(
        "import os, sys\nsys.modules.update(dict.fromkeys(os.environ['HIDDEN'].split()))\n"
    )

    def run(*arguments, hidden=HIDDEN, **keywords):
        return subprocess.run(
            [folder / "bin" / "python", *arguments],
            env=DRAWING | {"HIDDEN": hidden},
            cwd=folder,
            capture_output=True,
            text=True,
            **keywords,
        )

    return run


def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(wheel):
    files = [
        path.relative_to(ROOT)
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    files += [Path(path.name) for path in ROOT.glob("*.py") if path.name != "setup.py"]
    with zipfile.ZipFile(wheel) as packed:
        found = {name for name in packed.namelist() if ".dist-info/" not in name}
    assert found == {f"musebot/{path.as_posix()}" for path in [*files, Path("py.typed")]}


def test_the_light_core_and_gym_need_no_torch():
    for lines in (PROJECT["dependencies"], PROJECT["optional-dependencies"]["gym"]):
        assert not {"torch", "tyro"} & {Requirement(line).name for line in lines}


def test_the_extra_all_holds_what_users_need():
    extras = PROJECT["optional-dependencies"]
    (everything,) = map(Requirement, extras["all"])
    assert everything.extras == set(extras) - {"all", "dev", "docs"}


@pytest.mark.slow
def test_readmes_code_runs_from_the_wheel_without_torch(gym_only, egl):
    assert README
    done = gym_only("-c", RUN_BLOCKS, input=json.dumps(README))
    assert (done.returncode, done.stderr) == (0, "")
    assert "site-packages/musebot" in done.stdout.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "first"), [(HIDDEN, "tyro|rich"), ("torch", "torch")], ids=["gym", "without torch"]
)
def test_the_command_without_an_extra_is_one_sentence_and_status_2(gym_only, hidden, first):
    done = gym_only("-m", "musebot", "run", "out", hidden=hidden)
    sentence = rf"musebot: ({first}) is not installed; pip install 'musebot\[brain\]' gets it\n"
    assert done.returncode == 2
    assert re.fullmatch(sentence, done.stderr)


@pytest.mark.slow
def test_simulating_from_python_without_the_extra_says_how_to_get_it(gym_only):
    done = gym_only("-c", "import musebot; musebot.run('out')")
    assert re.search(r"ModuleNotFoundError: \w+ is not installed; pip install", done.stderr)


@pytest.mark.parametrize(
    ("module", "absent", "extra"),
    [
        ("controller", "torch", "brain"),
        ("tasks.stable_baselines", "stable_baselines3.common.vec_env.base_vec_env", "baselines"),
    ],
)
def test_a_module_without_its_extra_says_how_to_get_it(monkeypatch, module, absent, extra):
    monkeypatch.setitem(sys.modules, absent, None)
    monkeypatch.delitem(sys.modules, f"musebot.{module}", raising=False)
    with pytest.raises(ModuleNotFoundError, match=rf"pip install 'musebot\[{extra}\]' gets it"):
        __import__(f"musebot.{module}")


def test_gymnasiums_absence_is_one_sentence(monkeypatch):
    import musebot

    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'musebot\[gym\]' gets it"):
        musebot.register_gymnasium()


def test_every_requirement_of_an_extra_is_named_in_its_sentence():
    modules = {"pillow": "PIL", "imageio-ffmpeg": "imageio_ffmpeg", "pyyaml": "yaml"}
    for extra in ("brain", "gym", "cluster", "baselines", "tensorboard"):
        for line in PROJECT["optional-dependencies"][extra]:
            name = Requirement(line).name
            if name == "musebot":
                continue
            module = modules.get(name, name.replace("-", "_"))
            error = ModuleNotFoundError(f"No module named {module!r}", name=f"{module}.part")
            assert missing_extra(error).endswith(f"; pip install 'musebot[{extra}]' gets it"), name
    assert missing_extra(ModuleNotFoundError("No module named 'x'", name="x")).endswith("'x'")
    assert missing_extra(ImportError("torch is broken", name="torch")) == "torch is broken"


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("make"), reason="needs make")
def test_type_checkers_resolve_musebot_after_make(tmp_path):
    # The step of `make` for types, in an empty environment.
    environment = tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    target = environment / ".types"
    subprocess.run(["make", "-s", f"VENV={environment}", target], cwd=ROOT, check=True)
    script = tmp_path / "script.py"
    script.write_text(
        "import musebot\n"
        "environment = musebot.load('arena', 'wall_avoidance')\n"
        "reveal_type(environment.physics)\n"
        "reveal_type(environment.physics.robot_pose)\n"
    )
    command = ["-m", "pyright", "--pythonpath", environment / "bin" / "python", script]
    done = subprocess.run(
        [sys.executable, *command], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert 'Type of "environment.physics" is "Physics"' in done.stdout, done.stdout
    assert 'robot_pose" is "() -> ' in done.stdout
    assert "could not be resolved" not in done.stdout


@pytest.mark.slow
@pytest.mark.night
def test_an_empty_environment_with_gym_is_small_and_runs_readme(wheel, tmp_path, egl):
    environment = tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    python, began = environment / "bin" / "python", time.monotonic()
    install = [python, "-m", "pip", "install", "--quiet", f"{wheel}[gym]"]
    subprocess.run(install, check=True)
    seconds = time.monotonic() - began
    size = sum(path.stat().st_size for path in environment.rglob("*") if path.is_file()) / 1e6
    print(f"{size:.0f} MB in {seconds:.0f} s")
    assert size < 700
    torch = subprocess.run([python, "-c", "import torch"], capture_output=True, text=True)
    assert "No module named 'torch'" in torch.stderr
    done = subprocess.run(
        [python, "-c", RUN_BLOCKS],
        input=json.dumps(README), cwd=tmp_path, env=DRAWING, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    command = [environment / "bin" / "musebot", "run", "out"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, "musebot[brain]" in done.stderr) == (2, True)
