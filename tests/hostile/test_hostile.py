"""Hostile input of every kind: refused in one sentence, or of no effect on any result."""

import collections
import importlib.util

import pytest
from hostile import commands, environments, files, oracle, readers

from musebot.protocols.cli import parser as cli
from musebot.protocols.cli.verbs import study_command, verb_class

READERS, COMMANDS, CALLS = 4200, 4000, 1800  # cases at night
# In the ordinary suite: of each kind of file, of command lines, of each kind of call.
FEW, FEW_COMMANDS, FEW_CALLS = 10, 120, 15


@pytest.fixture(scope="session")
def base(tmp_path_factory, invented):
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("hostile")
    for name, seed in (("a", 1), ("b", 2)):
        files.make(folder / name, seed, invented)
    readers.learn_truth(folder)
    yield folder
    torch.set_num_threads(threads)


def counted(found):
    """Prints and returns how often each class of outcomes occurred."""
    counts = collections.Counter(outcome for outcome, _ in found)
    for outcome, count in sorted(counts.items()):
        print(f"  {count:6d}  {outcome.splitlines()[0][:160]}")
    return counts


@pytest.mark.parametrize("kind", files.KINDS, ids=lambda kind: kind.name)
def test_a_changed_file_is_refused_or_gives_the_same_results(base, tmp_path, kind):
    for number in range(FEW):
        outcome, said = readers.case(base, tmp_path / str(number), kind, number)
        assert not outcome.startswith("wrong"), f"{outcome}\n{said}"


@pytest.mark.night
@pytest.mark.parametrize("kind", files.KINDS, ids=lambda kind: kind.name)
def test_thousands_of_changed_files_are_refused_or_give_the_same_results(base, tmp_path, kind):
    each = READERS // len(files.KINDS)
    found = [readers.case(base, tmp_path / str(n), kind, n) for n in range(each)]
    print(f"\n{kind.name}: {each} cases, peak {oracle.peak_bytes() / 2**20:.0f} MiB")
    counted(found)
    wrong = [f"{outcome}\n{said}" for outcome, said in found if outcome.startswith("wrong")]
    assert not wrong, f"{len(wrong)} wrong:\n" + "\n\n".join(wrong[:20])


@pytest.fixture
def begun_only(monkeypatch):
    with commands.begun_only(monkeypatch):
        yield


# No work begins here: there is no such verb or study, no display, and nothing long to do.
WITHOUT_WORK = ("nothing", "study nothing", "explore", "check-agent")


@pytest.mark.usefixtures("begun_only")
@pytest.mark.parametrize("verb", [verb for verb in commands.VERBS if verb not in WITHOUT_WORK])
def test_the_sound_command_line_of_a_verb_reaches_its_work(verb, base, tmp_path, monkeypatch):
    words = commands.sound_words(verb, base, commands.places(base, tmp_path / "all"))
    monkeypatch.chdir(tmp_path)
    outcome = oracle.carried_out(lambda: (cli.main(words), None))
    assert outcome.status in (0, commands.WORK_BEGINS), outcome.printed


@pytest.mark.parametrize("verb", [verb for verb in commands.VERBS if "nothing" not in verb])
def test_hostile_command_lines_know_every_option_of_a_verb(verb):
    *studies, name = verb.removesuffix(" typical").split()
    known = cli._arguments(study_command(name) if studies else verb_class(name))
    options = {one.name for one in known if not one.positional}
    assert {*commands.VERBS[verb][1]} - {"--x"} == options


@pytest.mark.usefixtures("begun_only")
def test_a_hostile_command_line_is_refused_or_sound(base, tmp_path):
    for number in range(FEW_COMMANDS):
        outcome, said = commands.case(base, tmp_path / str(number), number)
        assert not outcome.startswith("wrong"), f"{outcome}\n{said}"


@pytest.mark.night
@pytest.mark.usefixtures("begun_only")
def test_thousands_of_hostile_command_lines_are_refused_or_sound(base, tmp_path):
    found = [commands.case(base, tmp_path / str(n), n) for n in range(COMMANDS)]
    print(f"\ncommand lines: {COMMANDS} cases, peak {oracle.peak_bytes() / 2**20:.0f} MiB")
    counted(found)
    wrong = [f"{outcome}\n{said}" for outcome, said in found if outcome.startswith("wrong")]
    assert not wrong, f"{len(wrong)} wrong:\n" + "\n\n".join(wrong[:30])


needs_gymnasium = pytest.mark.skipif(
    importlib.util.find_spec("gymnasium") is None, reason="needs the extra `gym`"
)


@needs_gymnasium
@pytest.mark.parametrize("kind", environments.KINDS)
def test_a_hostile_call_of_an_environment_is_one_error_or_finite(kind):
    for number in range(FEW_CALLS):
        outcome, said = environments.case(kind, number)
        assert not outcome.startswith("wrong"), f"{outcome}\n{said}"


@pytest.mark.night
@needs_gymnasium
@pytest.mark.parametrize("kind", environments.KINDS)
def test_thousands_of_hostile_calls_are_one_error_or_finite(kind):
    each = CALLS // len(environments.KINDS)
    found = [environments.case(kind, number) for number in range(each)]
    print(f"\n{kind}: {each} cases, peak {oracle.peak_bytes() / 2**20:.0f} MiB")
    counted(found)
    wrong = [f"{outcome}\n{said}" for outcome, said in found if outcome.startswith("wrong")]
    assert not wrong, f"{len(wrong)} wrong:\n" + "\n\n".join(wrong[:20])
