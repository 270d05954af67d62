"""Hostile input of every kind: refused in one sentence, or of no effect on any result."""

import collections

import pytest

from hostile import files, oracle, readers

READERS = 3600  # cases at night, over all kinds
FEW = 8  # of each kind, in the ordinary suite


@pytest.fixture(scope="session")
def base(tmp_path_factory, invented, in_process):
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("hostile")
    for name, seed in (("a", 1), ("b", 2)):
        files.make(folder / name, seed, invented, in_process())
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
