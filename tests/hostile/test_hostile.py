"""Hostile input of every kind: refused in one sentence, or of no effect on any result."""

import collections
import importlib.util
import resource
from functools import partial

import pytest
from hostile import commands, environments, files, oracle

from musebot.protocols.cli import parser as cli

COMMANDS, CALLS = 4000, 2000  # cases at night
# In the ordinary suite: of command lines, of each kind of call.
FEW_COMMANDS, FEW_CALLS = 120, 15


@pytest.fixture(scope="session")
def base(tmp_path_factory, invented):
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("hostile")
    for name, seed in (("a", 1), ("b", 2)):
        files.make(folder / name, seed, invented)
    yield folder
    torch.set_num_threads(threads)


def judged(what, cases):
    """Carries out cases and prints the classes of outcomes; none may be wrong."""
    found = [case() for case in cases]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # on Linux
    print(f"\n{what}: {len(found)} cases, peak {peak:.0f} MiB")
    for outcome, count in sorted(collections.Counter(outcome for outcome, _ in found).items()):
        print(f"  {count:6d}  {outcome.splitlines()[0][:160]}")
    wrong = [f"{outcome}\n{said}" for outcome, said in found if outcome.startswith("wrong")]
    assert not wrong, f"{len(wrong)} wrong:\n" + "\n\n".join(wrong[:30])


few_or_thousands = pytest.mark.parametrize(
    "share", [0, pytest.param(1, marks=pytest.mark.night)], ids=["few", "thousands"]
)


@pytest.mark.parametrize("kind", files.KINDS, ids=lambda kind: kind.name)
def test_what_stands_in_the_place_of_a_file_is_refused_or_gives_no_other_results(
    base, tmp_path, kind
):
    assert kind.work(base / "a")[0] == 0
    places = files.places(kind, base / "b")
    judged(kind.name, (partial(files.case, base, tmp_path / "case", kind, p) for p in places))


@pytest.fixture
def begun_only(monkeypatch):
    commands.begun_only(monkeypatch)


@pytest.mark.usefixtures("begun_only")
@pytest.mark.parametrize("verb", [verb for verb in commands.VERBS if verb != "explore"])
def test_the_sound_command_line_of_a_verb_reaches_its_work(verb, base, tmp_path, monkeypatch):
    words = commands.sound_words(verb, commands.places(base, tmp_path / "all"))
    monkeypatch.chdir(tmp_path)
    outcome = oracle.carried_out(lambda: (cli.main(words), None))
    assert outcome.status in (0, commands.WORK_BEGINS), outcome.printed


@few_or_thousands
@pytest.mark.usefixtures("begun_only")
def test_a_hostile_command_line_is_refused_or_sound(base, tmp_path, share):
    cases = COMMANDS if share else FEW_COMMANDS
    judged(
        "command lines",
        (partial(commands.case, base, tmp_path / str(n), n) for n in range(cases)),
    )


@few_or_thousands
@pytest.mark.parametrize("kind", environments.KINDS)
def test_a_hostile_call_of_an_environment_is_one_error_or_finite(kind, share):
    if importlib.util.find_spec("gymnasium") is None:
        pytest.skip("needs the extra `gym`")
    cases = CALLS // len(environments.KINDS) if share else FEW_CALLS
    judged(kind, (partial(environments.case, kind, n) for n in range(cases)))
