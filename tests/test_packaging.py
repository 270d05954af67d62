"""The wheel: what it holds, and what works where only the wheel and some extras are installed."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from musebot.extras import missing_extra

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FOLDERS = ("models", "tasks", "controller", "protocols")
README = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
# README's code renders a picture; the other tests switch OpenGL off.
DRAWING = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYTHONPATH")}
# What only the extras `brain`, `baselines` and `cluster` install.
HIDDEN = "torch safetensors matplotlib jinja2 rich ray stable_baselines3"

# Runs all blocks in one process, each with names of its own.
RUN_BLOCKS = """
import json, sys
import musebot
for block in json.load(sys.stdin):
    exec(block, {"__name__": "block"})
assert sys.modules.get("torch") is None
print(musebot.__file__)
"""


def run(*command, env=DRAWING, **keywords):
    return subprocess.run(command, env=env, capture_output=True, text=True, **keywords)


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    """Path of a wheel that is built as `make dist` builds it."""
    folder = tmp_path_factory.mktemp("build")
    own = shutil.ignore_patterns(".*", "__pycache__")
    root = shutil.ignore_patterns(".*", "docs", "runs", "build", "dist", "tests", "__pycache__")

    def skipped(directory, names):
        return (root if Path(directory) == ROOT else own)(directory, names)

    shutil.copytree(ROOT, folder / "any-name", ignore=skipped)
    project = folder / "any-name" / "pyproject.toml"
    project.write_text(project.read_text().replace("example.org", "named.org"))
    code = "from setuptools import build_meta; print(build_meta.build_wheel('..'))"
    done = run(sys.executable, "-c", code, cwd=folder / "any-name")
    assert done.returncode == 0, done.stderr
    return folder / done.stdout.splitlines()[-1]


def without_torch(wheel, folder):
    """Returns the path of a Python with the wheel, and of our packages all but the HIDDEN ones."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    with zipfile.ZipFile(wheel) as files:
        files.extractall(site)
    shared = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    (site / "shared.pth").write_text("\n".join(shared))
    (site / "sitecustomize.py").write_text(
        f"import sys\nsys.modules.update(dict.fromkeys({HIDDEN.split()}))\n"
    )
    return folder / "bin" / "python"


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
        (about,) = (name for name in packed.namelist() if name.endswith("/METADATA"))
        readme = packed.read(about).decode()
    assert found == {f"musebot/{path.as_posix()}" for path in [*files, Path("py.typed")]}
    links = re.findall(r'(?:\]\(|src=")([^)"#]+)', readme)
    assert len(links) > 10 and all(link.startswith("http") for link in links)


def requirements(extra):
    """Returns the packages that an extra adds, without musebot's own."""
    names = {Requirement(line).name for line in PROJECT["optional-dependencies"][extra]}
    return names - {"musebot"}


def test_extras_hold_what_users_need_the_light_ones_no_torch_and_pins_are_given_once():
    light = {Requirement(line).name for line in PROJECT["dependencies"]} | requirements("gym")
    assert not light & {"torch", "rich", "matplotlib"}
    extras = PROJECT["optional-dependencies"]
    (everything,) = map(Requirement, extras["all"])
    assert everything.extras == set(extras) - {"all", "dev", "docs"}
    site, others = (
        re.findall(r"^([\w.-]+)==", (ROOT / file).read_text().lower().replace("_", "-"), re.M)
        for file in ("constraints/docs.txt", "constraints/base.txt")
    )
    assert requirements("docs") <= {*site} and len({*site, *others}) == len(site + others)


def test_a_missing_requirement_is_a_sentence_that_names_its_extra():
    modules = {"pillow": "PIL", "markdown-it-py": "markdown_it", "warp-lang": "warp"}
    for extra in ("brain", "gym", "cluster", "baselines", "tensorboard", "numba", "warp"):
        for name in requirements(extra):
            module = modules.get(name, name.replace("-", "_"))
            error = ModuleNotFoundError(f"No module named {module!r}", name=f"{module}.part")
            assert missing_extra(error).endswith(f"; pip install 'musebot[{extra}]' gets it"), name
    assert missing_extra(ModuleNotFoundError("No module named 'x'", name="x")).endswith("'x'")
    assert missing_extra(ImportError("torch is broken", name="torch")) == "torch is broken"


NEEDS = {
    "musebot.controller.Neurocontroller": ("torch", "brain"),
    "musebot.run('out')": ("torch", "brain"),
    "import musebot.tasks.stable_baselines": ("stable_baselines3", "baselines"),
    "import musebot.tasks.gymnasium_env": ("gymnasium", "gym"),
    "musebot.register_gymnasium()": ("gymnasium", "gym"),
    "import musebot.tasks.stable_baselines as _": ("gymnasium", "baselines"),
}
WITHOUT = """
import sys
import musebot
for absent, code in zip(sys.argv[1::2], sys.argv[2::2]):
    sys.modules[absent] = None
    try:
        exec(code)
    except ModuleNotFoundError as error:
        print(error)
"""


def test_python_without_an_extra_says_how_to_get_it(tmp_path):
    words = [word for code, (absent, _) in NEEDS.items() for word in (absent, code)]
    done = run(sys.executable, "-c", WITHOUT, *words, env=os.environ, cwd=tmp_path)
    for (absent, extra), sentence in zip(NEEDS.values(), done.stdout.splitlines(), strict=True):
        end = rf"is not installed; pip install 'musebot\[{extra}\]' gets it"
        assert re.fullmatch(rf"{absent}\S* {end}", sentence)


# Commands without torch: their status, and what they print.
COMMANDS = {
    "doctor": ({0, 1}, r"^Python +ok .*\nmujoco +ok "),
    "run out": ({2}, r"^musebot: \w+ is not installed; pip install 'musebot\[brain\]' gets it\n$"),
}


@pytest.mark.slow
def test_the_wheel_without_torch_runs_readmes_code_and_the_command(wheel, egl, tmp_path):
    python = without_torch(wheel, tmp_path / "environment")
    assert README
    done = run(python, "-c", RUN_BLOCKS, input=json.dumps(README), cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "site-packages/musebot" in done.stdout.splitlines()[-1]
    for words, (status, printed) in COMMANDS.items():
        done = run(python, "-m", "musebot", *words.split(), cwd=tmp_path)
        assert done.returncode in status, done.stderr
        assert re.search(printed, done.stdout + done.stderr), words
