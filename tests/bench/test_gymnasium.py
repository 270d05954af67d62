"""The Gymnasium interfaces: the comparison times equal work."""

import json

import pytest

pytest.importorskip("gymnasium", reason="needs the extra `gym`")

from musebot.protocols.bench import bench  # noqa: E402
from musebot.protocols.bench.gymnasium import InterfaceCosts, measure  # noqa: E402
from musebot.protocols.errors import InputError  # noqa: E402


def test_bare_physics_and_the_batch_do_the_same_work_and_both_are_timed():
    costs = measure(robots=4, threads=2, rounds=2, steps=5)  # raises if the states differ
    assert costs.substeps == 14
    assert len(costs.batch) == len(costs.bare) == len(costs.single) == 2
    assert min(*costs.batch, *costs.bare, *costs.single) > 0


def test_rates_are_the_medians_of_the_rounds():
    costs = InterfaceCosts(10, 2, 14, (1.0, 2.0, 4.0), (0.9, 1.0, 3.6), (4.0, 10.0, 16.0), ())
    assert costs.over_bare == 0.9
    assert costs.over_single == 4.0
    text = costs.section()
    assert "at 0.90 of the rate of bare physics and at 4.0 times the rate of single" in text
    assert "| `make_vec`, the batch | 5 | 70 |" in text


def test_interfaces_are_measured_alone_and_their_seconds_are_saved(tmp_path, capsys):
    bench.run(json_file=tmp_path / "bench.json", quick=True, interfaces=True)
    text = capsys.readouterr().out
    titles = [line for line in text.splitlines() if line.startswith("### ")]
    assert titles == ["### Machine", "### Gymnasium interfaces"]
    content = json.loads((tmp_path / "bench.json").read_text())
    assert content.keys() == {"interfaces", "machine"}
    assert min(content["interfaces"]["batch"]) > 0


def test_interfaces_exclude_the_figure_of_the_lives(tmp_path):
    with pytest.raises(InputError, match="cannot be combined with --figure"):
        bench.run(figure=tmp_path / "cost.svg", interfaces=True)
