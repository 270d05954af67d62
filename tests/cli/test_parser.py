"""The command line: from words to a verb, and one sentence for what cannot be read."""

import dataclasses
import importlib
import os
import re
import subprocess
import sys

import pytest

import musebot
from musebot.protocols.cli import parser as cli
from musebot.protocols.cli.options import argument, option
from musebot.protocols.cli.verbs import BENCHMARK, VERBS, verb_class
from musebot.protocols.errors import InputError

COMMANDS = [name for name in VERBS if name != "benchmark"] + [*BENCHMARK]


@dataclasses.dataclass
class Drive:
    """Drive somewhere."""

    out: str = argument("where to", "OUT")
    speed: float = option(1.0, "how fast", "X")
    wheels: int | None = option(None, "how many", "N")
    gears: tuple[str, ...] = option((), "which gears", "GEAR")
    mood: str = option("calm", "how", choices=("calm", "wild"))
    loud: bool = option(False, "with noise")


def drive(*words):
    return cli.parsed(Drive, "musebot drive", words)


def test_words_give_the_fields_of_a_command_wherever_they_stand():
    for words, given in (
        ("a", {}),
        ("a --speed 2", {"speed": 2.0}),
        ("--speed=2 a", {"speed": 2.0}),
        ("a --gears 1 2 --loud", {"gears": ("1", "2"), "loud": True}),
        ("a --wheels -3", {"wheels": -3}),
        ("a --mood=wild", {"mood": "wild"}),
    ):
        assert drive(*words.split()) == Drive("a", **given)


def test_words_that_a_command_does_not_take_are_one_sentence():
    for words, sentence in (
        ([], "missing: OUT"),
        (["a", "b"], "'b' is one word too many"),
        (["a", ""], "a word of the command is empty: is a variable of the shell unset?"),
        (["a", "--sped", "2"], "there is no option --sped; did you mean --speed?"),
        (["a", "--spee", "2"], "there is no option --spee; did you mean --speed?"),
        (["--out", "a"], "--out is no option: its value stands without --out"),
        (["a", "--speed", "fast"], "--speed must be a number, got 'fast'"),
        (["a", "--wheels", "2.5"], "--wheels must be a whole number, got '2.5'"),
        (["a", "--mood", "bad"], "--mood must be one of calm, wild, got 'bad'"),
        (["a", "--loud", "--loud"], "--loud is given twice: give it once, followed by all its"),
        (["a", "--speed"], "--speed: expected one argument"),
        (["a", "--loud=1"], "--loud: ignored explicit argument '1'"),
    ):
        with pytest.raises(InputError) as caught:
            drive(*words)
        assert sentence in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("verb", COMMANDS)
def test_help_of_a_verb_names_every_option_and_fits_on_a_screen(verb, capsys, monkeypatch):
    fields = dataclasses.fields(verb_class(verb))
    assert len([f for f in fields if f.metadata["option"]]) <= 18
    for columns, most in (("1", 999), ("80", 24), ("400", 999)):
        monkeypatch.setenv("COLUMNS", columns)
        assert cli.main([*verb.split(), "--help"]) == 0
        text = capsys.readouterr().out
        for field in fields:
            name = field.metadata["values"]
            if field.metadata["option"]:
                name = f"--{field.name.replace('_', '-')}"
            before, found, _ = re.split(rf"^(  {re.escape(name)}\b)", text, maxsplit=1, flags=re.M)
            assert found and field.metadata["says"]
            heading = (field.metadata["group"] or "options") if field.metadata["option"] else ""
            assert ["", *re.findall("^([a-z].*):$", before, re.M)][-1] == heading
        lines = text.splitlines()
        assert max(map(len, lines)) <= 100 and len(lines) <= most


@pytest.mark.parametrize("verb", BENCHMARK)
def test_a_command_its_help_and_its_study_have_the_same_defaults(verb):
    command = verb_class(verb)
    module, name = command.study
    study = getattr(importlib.import_module(f"musebot.protocols.compare.{module}"), name)
    usual = {field.name: field.default for field in dataclasses.fields(study)}
    for field in dataclasses.fields(command):
        if field.name in usual and field.default not in ((), dataclasses.MISSING):
            assert field.default == usual[field.name]
            number = isinstance(field.default, float)
            shown = f"{field.default:g}" if number else field.default
            assert field.metadata["says"].endswith(f"({shown})")


def test_no_word_shows_the_verbs_and_version_the_version(capsys):
    assert cli.main([]) == 0
    text = capsys.readouterr().out
    assert all(re.search(f"^  {verb} ", text, re.M) for verb in VERBS) and len(VERBS) <= 9
    assert cli.main(["benchmark"]) == 0
    text = capsys.readouterr().out
    assert all(re.search(f"^  {verb.split()[1]} ", text, re.M) for verb in BENCHMARK)
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"musebot {musebot.__version__}\n"


def test_an_unknown_verb_gets_the_nearest_one(capsys):
    for words, nearest in ((["tabels", "x"], "tables"), (["benchmark", "tun"], "benchmark tune")):
        assert cli.main(words) == 2
        err = capsys.readouterr().err
        assert f"did you mean {nearest}" in err and err.count("\n") == 1


def fresh(code, **environment):
    """Runs code in a new process; returns what it printed on stderr."""
    command, environment = [sys.executable, "-c", code], os.environ | environment
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stderr


HEAVY = ("torch", "mujoco", "matplotlib", "scipy", "rich", "safetensors", "jinja2")


def test_help_and_lists_work_without_the_extra_brain_and_other_verbs_say_that_they_need_it():
    # A module that is None cannot be imported, as if it were not installed.
    code = f"""
import sys
sys.modules.update(dict.fromkeys({HEAVY!r}))
from musebot.protocols.cli.parser import main
for words in (["list"], ["run", "--help"], ["--help"], ["--version"]):
    assert main(words) == 0
del sys.modules["mujoco"]  # the plain install has it
assert main(["tables", "nowhere"]) == 2
"""
    assert "pip install 'musebot[brain]' gets it" in fresh(code)


def test_a_wrong_mujoco_is_one_sentence_and_exit_status_2(tmp_path):
    code = f"""
import mujoco
mujoco.__version__ = "4.0.0"
from musebot.protocols.cli.parser import main
assert main(["run", {str(tmp_path / "new")!r}]) == 2
"""
    fresh(code, MUJOCO_GL="off")
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_closes_the_pipe_early_sees_no_complaint():
    read, write = os.pipe()
    os.close(read)
    with open(write, "wb") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "musebot", "list"],
            stdout=closed, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (141, "")
