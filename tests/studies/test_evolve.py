"""The study that evolves parameters: its space, its course, resuming, and its page."""

import dataclasses
import re
import shutil
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from musebot.controller import BRAINS
from musebot.protocols import cli
from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.experiment.overrides import named_brain, with_overrides
from musebot.protocols.experiment.schedules import PARTS
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.protocols.studies.search.evolve import FOLDER, Evolve
from musebot.protocols.studies.search.evolve_page import Evolution, Generation, draw
from musebot.protocols.studies.search.space import RANGES, brain_at, check_names, point_of
from musebot.protocols.studies.study import conduct

STEADY = BRAINS["steady"]
TINY = Evolve(over=("learn_rate", "noise"), budget=9, generation=4, robots=3, time_scale=0.001)


# ---- The space ----


@given(st.sampled_from(sorted(RANGES)), st.floats(-1, 2))
def test_every_coordinate_gives_a_value_in_the_range_that_parameters_allow(name, coordinate):
    own = RANGES[name]
    value = own.value(coordinate)
    assert own.low <= value <= own.high * (1 + 1e-5)
    brain = brain_at(np.array([coordinate]), [name], STEADY)  # raises ValueError where not allowed
    assert getattr(brain, name) == value
    assert isinstance(value, int) is own.whole


@given(st.sampled_from(sorted(RANGES)), st.floats(0, 1))
def test_a_coordinate_is_found_again_from_its_value(name, coordinate):
    own = RANGES[name]
    value = own.value(coordinate)
    # Values are rounded as written; whole numbers to the next one.
    again = own.value(own.coordinate(value))
    assert again == pytest.approx(value, rel=1e-5, abs=1e-6)


def test_a_log_range_is_cut_into_equal_factors():
    assert RANGES["learn_rate"].value(0.5) == pytest.approx(1e-3)
    assert RANGES["noise"].value(0.5) == pytest.approx(1.0)


def test_a_range_of_decays_is_cut_into_equal_factors_of_their_time():
    # Time constants of 1, 10, 100 and 1,000 steps.
    own = RANGES["reward_decay"]
    values = [own.value(third / 3) for third in range(4)]
    assert values == pytest.approx([0, 0.9, 0.99, 0.999])
    assert [own.coordinate(value) for value in values] == pytest.approx([0, 1 / 3, 2 / 3, 1])


def test_only_the_searched_parameters_of_a_brain_change():
    names = ("noise", "epsilon")
    brain = brain_at(np.array([0.25, 0.5]), names, STEADY)
    changed = {
        field.name
        for field in dataclasses.fields(brain)
        if getattr(brain, field.name) != getattr(STEADY, field.name)
    }
    assert changed == {*names}
    np.testing.assert_allclose(point_of(brain, names), [0.25, 0.5], atol=1e-5)


def test_parameters_may_be_separated_by_commas():
    assert Evolve(over=("learn_rate,noise",)).over == TINY.over
    with pytest.raises(InputError, match="there is no parameter '' to search"):
        Evolve(over=("learn_rate,,noise",)).experiments()


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        ((), "over needs at least one of"),
        (("lern_rate",), "there is no parameter 'lern_rate' to search: did you mean learn_rate"),
        (("noise", "noise"), "the parameters must differ"),
        (("td_error_limit",), "the brain has no td_error_limit: give it a value first"),
    ],
)
def test_a_parameter_that_cannot_be_searched_is_refused(names, sentence):
    with pytest.raises(InputError, match=sentence):
        check_names(names, STEADY)


@pytest.mark.parametrize(
    ("brain", "name", "sentence"),
    [
        (BRAINS["paper"], "exploration_steps", "from 1 to 60, but the search would start at 0: "),
        (dataclasses.replace(STEADY, noise=3.0), "noise", "from 0 to 2, but .* start at 3: "),
        (BRAINS["paper"], "epsilon_decay_steps", "has no effect without initial_epsilon: "),
        (BRAINS["paper"], "learn_rate_decay_steps", "has no effect without initial_learn_rate: "),
    ],
)
def test_a_search_starts_at_its_brain_and_changes_what_has_an_effect(brain, name, sentence):
    with pytest.raises(InputError, match=f"^{name} .*{sentence}give it a"):
        check_names([name], brain)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("noise", "noise cannot be evolved: at 0, noise_adaptation needs noise and "),
        (
            "random_share",
            "random_share cannot be evolved: at 0.9, noise_adaptation needs .* at least 2 ideas",
        ),
    ],
)
def test_a_range_that_another_parameter_excludes_is_refused_before_the_search(name, sentence):
    adapted = dataclasses.replace(STEADY, ideas=3, keep_main_idea=True, noise_adaptation=0.01)
    with pytest.raises(InputError, match=sentence):
        check_names([name], adapted)


# ---- The course ----


@pytest.fixture(scope="module")
def finished(tmp_path_factory, in_process):
    out = tmp_path_factory.mktemp("evolve") / "out"
    return out, conduct(TINY, out, in_process())


def test_each_generation_has_new_seeds_and_its_brains_share_them(finished):
    out, _ = finished
    notes = [load_arrays(path)[1] for path in sorted((out / FOLDER).glob("0*.safetensors"))]
    assert [note["seed"] for note in notes] == [1] * 4 + [2] * 4
    finals = [load_arrays(path)[1] for path in sorted((out / FOLDER).glob("final*"))]
    assert sorted({note["seed"] for note in finals}) == [3, 4, 5, 6]
    brains = {tuple(note[f"brain.{name}"] for name in TINY.over) for note in notes}
    assert len(brains) == 8  # all differ


def test_the_winner_is_the_mean_of_the_search_and_lives_on_fresh_seeds(finished):
    out, page = finished
    evolution = TINY.evolution(out)
    assert len(evolution.generations) == 2
    assert {name: len(shares) for name, shares in evolution.tests.items()} == {
        "start": 4 * TINY.robots,
        "winner": 4 * TINY.robots,
        "best": 4 * TINY.robots,
    }
    brain = brain_at(evolution.generations[-1].mean, TINY.over, STEADY)
    winners = (out / FOLDER).glob("final*winner*")
    assert {load_arrays(path)[1]["brain.noise"] for path in winners} == {brain.noise}
    assert "| winner | 12 |" in page.markdown
    assert "Difference of winner and first brain" in page.markdown
    assert "protocol `paper`, all durations times 0.001, kinematic simulator " in page.markdown
    (words,) = re.findall(r"`--task .* --brain steady --set (.*)`\.", page.markdown)
    assert with_overrides(named_brain("steady"), words.split()) == brain


def test_the_best_brain_of_the_last_generation_is_tested_on_fresh_seeds(finished):
    out, page = finished
    last = TINY.evolution(out).generations[-1]
    brain = brain_at(last.points[last.fitness.argmax()], TINY.over, STEADY)
    best = [load_arrays(path)[1] for path in (out / FOLDER).glob("final*best*")]
    assert len(best) == 4 and {note["brain.noise"] for note in best} == {brain.noise}
    assert f"last generation had {last.fitness.max():.3f} on its own seed" in page.markdown


def test_the_printed_winner_holds_what_was_set_before_the_search():
    study = dataclasses.replace(TINY, set=("discount=0.8",))
    start = "--task spot_finding --proposer creative --brain steady"
    assert study.options_of(study.start.brain) == f"{start} --set discount=0.8"
    assert study.options_of(STEADY) == start
    walls = dataclasses.replace(TINY, protocol="walls")
    assert walls.options_of(STEADY) == f"{start} --protocol walls"


def test_a_search_that_was_stopped_makes_the_same_brains(finished, tmp_path, in_process):
    out, page = finished
    kept = {path.name: path.read_bytes() for path in (out / FOLDER).iterdir()}
    conduct(dataclasses.replace(TINY, budget=4), tmp_path / "two", in_process())
    again = conduct(TINY, tmp_path / "two", in_process())
    two = {path.name: path.read_bytes() for path in (tmp_path / "two" / FOLDER).iterdir()}
    assert kept.items() <= two.items()  # also the finals of the smaller budget
    assert again.markdown == page.markdown


def test_a_file_of_another_brain_is_named_and_refused(finished, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(finished[0], out)
    path = out / FOLDER / "000-01.safetensors"
    arrays, notes = load_arrays(path)
    save_arrays(path, arrays, **notes | {"seed": 99})
    with pytest.raises(DamagedFileError, match="000-01.safetensors is another's: its seed is 99"):
        TINY.check(out)


def test_an_unstable_robot_counts_as_the_worst(tmp_path):
    for task, worst in (("spot_finding", 0.0), ("wall_avoidance", 1.0)):
        study = dataclasses.replace(TINY, task=task)
        _, (job, *_) = study._generation(study._search(), 0, tmp_path / task)
        job.path.parent.mkdir(parents=True)
        arrays = {"events": np.full((3, 3), 1, np.int32), "valid": np.array([True, False, True])}
        save_arrays(job.path, arrays, **job._identity)
        assert job.shares()[1] == worst
        assert 0 < job.shares()[0] < 1


def test_a_share_is_that_of_its_part_of_the_life(tmp_path):
    _, (job, *_) = TINY._generation(TINY._search(), 0, tmp_path / "parts")
    job.path.parent.mkdir(parents=True)
    schedule = job.experiment.schedule(job.condition.task)
    events = np.array([[schedule.steps_of(part) // n for n, part in enumerate(PARTS, 1)]] * 3)
    save_arrays(
        job.path, {"events": events.astype(np.int32), "valid": np.ones(3, bool)}, **job._identity
    )
    for n, part in enumerate(PARTS, 1):
        assert job.shares(part) == pytest.approx([1 / n] * 3, abs=0.02)


def test_the_search_finds_the_top_of_a_hill():
    """The study's search with a fitness that is known: highest at (0.8, 0.3)."""
    study = dataclasses.replace(TINY, generation=8)
    search = study._search()
    for _ in range(30):
        points = [search.ask() for _ in range(8)]
        search.tell([(x, float(((x - [0.8, 0.3]) ** 2).sum())) for x in points])
    np.testing.assert_allclose(search.mean, [0.8, 0.3], atol=0.02)


def test_the_weight_of_a_parameter_is_its_correlation_within_generations():
    random = np.random.default_rng(1)
    generations = []
    for number in range(6):
        points = random.uniform(size=(10, 2))
        generations.append(Generation(points, points[:, 0] + 5 * number, points.mean(axis=0)))
    weights = Evolution(("noise", "epsilon"), generations).weights()
    assert weights[0][1] > 0.9
    assert abs(weights[1][1]) < 0.4
    assert Evolution(("noise", "epsilon"), generations[:1]).weights() == []


def test_the_figure_shows_every_brain_the_means_and_both_tests():
    points = np.zeros((3, 2))
    generations = [
        Generation(points, np.array([-0.5, -0.3, -0.1]), np.array([0.2, 0.9])),
        Generation(points, np.array([-0.4, -0.3, -0.05]), np.array([0.3, 0.7])),
    ]
    tests = {"start": np.array([0.7, 0.5]), "winner": np.array([0.1, 0.3])}
    evolution = Evolution(("noise", "epsilon"), generations, tests)
    above, below = draw(evolution, -1, "in contact").axes
    first, second, means, *levels = above.lines
    assert first.get_xydata() == pytest.approx(np.array([[1, 0.5], [1, 0.3], [1, 0.1]]))
    assert second.get_xydata() == pytest.approx(np.array([[2, 0.4], [2, 0.3], [2, 0.05]]))
    assert means.get_xydata() == pytest.approx(np.array([[1, 0.3], [2, 0.25]]))
    names = {text.get_color(): (text.get_text(), text.xy[1]) for text in above.texts}
    found = {names[line.get_color()]: line.get_ydata()[0] for line in levels}
    assert found == pytest.approx(
        {("first brain,\nfresh seeds", 0.6): 0.6, ("winner,\nfresh seeds", 0.2): 0.2}
    )
    names = {text.get_color(): (text.get_text(), text.xy) for text in below.texts}
    found = {names[line.get_color()]: [*line.get_ydata()] for line in below.lines}
    assert found == {("noise", (2, 0.3)): [0.2, 0.3], ("epsilon", (2, 0.7)): [0.9, 0.7]}


# ---- Options ----


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--budget", "0"], "budget must be at least 1"),
        (["--budget", "5"], "the budget must be at least one generation of 10 brains, got 5"),
        (["--generation", "1"], "a generation needs at least 4 brains, got 1"),
        (["--over", "nois"], "did you mean noise"),
        (["--set", "noise=-1"], "noise must lie in"),
        (["--brain", "divine"], "the brain must be one of"),
        (["--task", "wall_avoidance", "--protocol", "walls"], "the task must be one of"),
        (["--protocol", "night"], "the protocol must be one of"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(words, sentence, tmp_path, capsys):
    assert cli.main(["study", "evolve", str(tmp_path / "out"), *words]) == 2
    complaint = capsys.readouterr().err
    assert sentence in complaint and complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_without_cmaes_the_sentence_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "cmaes", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'musebot\[evolve\]'"):
        TINY.experiments()
