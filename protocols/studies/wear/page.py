"""The page of the study: tables of each change, the verdict, and the curves of recovery."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from ....models import CHANGES, Kinematics
from ...analysis import intervals
from ...analysis.survival import kaplan_meier
from ...experiment.experiment import Experiment
from ...experiment.overrides import overrides_of
from ...reporting import style
from ...reporting.labels import durations
from ...reporting.markdown import probability, table, with_interval
from ..study import Page
from .arms import ARMS, FROZEN, NEWBORN
from .recovery import (
    END,
    Arms,
    Recovery,
    against_newborns,
    effects,
    mean_minutes,
    noise_pairs,
    noise_pairs_by_share,
    verdict,
)

_SIGNS = {1: "helps", 0: "-", -1: "hinders"}
_SHOWN = ("trained-noise", "trained-quiet")  # arms in the figure, besides the controls


def page(changes: Mapping[str, Arms], experiment: Experiment) -> Page:
    """Returns the page made from the finished arms.

    Args:
      changes: Recovery by change and arm.
      experiment: Experiment of the lives.
    """
    simulator = "MuJoCo"
    if experiment.body == "kinematic":
        kinematics = overrides_of(experiment.kinematics, Kinematics())
        simulator = " ".join(["Kinematic simulator", *kinematics])
    where = f"{simulator}; seed {experiment.seed}{durations(experiment)}."
    lines = [f"Old brains in a changed body (docs/plans/wear.md). {where}", ""]
    figures = {}
    for change, found in changes.items():
        arms = {name: found[name] for name in ARMS if name in found}
        lines += [f"### {change}: {CHANGES[change].says}", ""]
        if not arms:
            lines += ["No arm is finished yet.", ""]
            continue
        lines += [*_arms(arms), *_pairs(arms), *_effects(arms), *_goal(arms)]
        with style.styled():
            figures[f"wear-{change}"] = draw(arms)
    return Page("\n".join(lines), figures)


def _arms(arms: Arms) -> list[str]:
    tested = against_newborns(arms)
    rows = [
        ["arm", "robots", "in the spot at once", "at the end", "recovered", "median, minutes"]
        + ["mean, minutes", "p against newborns (Holm)"]
    ]
    for name, arm in arms.items():
        times, kept = arm.durations, arm.shares[:, arm.learned]
        count = int(times.happened.sum())
        curve = kaplan_meier(times) if len(times) else None
        rows.append(
            [
                f"`{name}`",
                str(len(times)),
                *(f"{np.nanmean(kept[k]):.3f}" if len(times) else "-" for k in (0, -1)),
                with_interval(str(count), intervals.share(count, len(times)), percent=True),
                "-" if curve is None else _minutes(curve.median, curve.median_interval),
                _plain(mean_minutes(arm)),
                probability(tested[name].p) if name in tested else "",
            ]
        )
    one = next(iter(arms.values()))
    stopped = max(int(np.isnan(arm.shares[-1]).sum()) for arm in arms.values())
    left_out = int((~one.learned).sum())
    return [
        *table(rows),
        "",
        "Recovered: a probe of ten minutes with frozen weights has at least 90 % of the robot's "
        "share of time in the spot before the change. Share with Wilson's interval; median of the "
        "Kaplan-Meier curve with its log-log interval; mean restricted to "
        f"{END:.0f} minutes; log-rank test. Left out: {left_out} robots that had not learned "
        f"(below 0.5 before the change); at most {stopped} in an arm were stopped.",
        "",
    ]


def _pairs(arms: Arms) -> list[str]:
    tested = noise_pairs(arms)
    if not tested:
        return []
    rows = [
        ["with noise", "without", "minutes", "p (Holm)", "noise", "in the spot", "p (Holm)"]
        + ["noise"]
    ]
    by_share = noise_pairs_by_share(arms)
    for time, share in zip(tested, by_share, strict=True):
        rows.append(
            [
                f"`{time.first}`",
                f"`{time.second}`",
                _signed(time.difference),
                probability(time.p),
                _SIGNS[time.sign],
                "-" if math.isnan(share.difference) else f"{share.difference:+.3f}",
                probability(share.p),
                _SIGNS[share.sign],
            ]
        )
    return [
        *table(rows, "llrrlrrl"),
        "",
        "With noise minus without. Minutes: restricted mean time to recovery, log-rank test. "
        f"**{verdict(arms, tested)}** In the spot: mean share of the probes from ten minutes after "
        "the change on, permutation test of the same robots in pairs. "
        f"**{verdict(arms, by_share)}** Which of the two decides: docs/plans/wear.md.",
        "",
    ]


def _effects(arms: Arms) -> list[str]:
    found = effects(arms)
    if not found:
        return []
    rows = [["effect", "pairs of arms", "minutes"]]
    rows += [
        [name, str(count), with_interval(_signed(value), interval)]
        for name, (count, value, interval) in found.items()
    ]
    return [
        *table(rows),
        "",
        "Difference of the restricted time for each robot, mean over pairs of arms that differ in "
        "the factor alone; 95 % interval (BCa bootstrap over robots). Not tested. Main effects "
        "without the arms `quiet-own`, which cannot learn.",
        "",
    ]


def _goal(arms: Arms) -> list[str]:
    medians = {
        name: kaplan_meier(arm.durations).median
        for name, arm in arms.items()
        if len(arm.durations) and (name.startswith("trained-") or name == NEWBORN)
    }
    newborns = medians.pop(NEWBORN, math.nan)
    if math.isnan(newborns) or not medians:
        return []
    best = min(medians, key=medians.__getitem__)
    met = medians[best] <= min(newborns, END) / 4  # a median after the last probe is unknown
    return [
        f"Goal, a quarter of the newborns' median: {'met' if met else 'not met'}; the best arm, "
        f"`{best}`, has {_plain(medians[best])} minutes, newborns have {_plain(newborns)}.",
        "",
    ]


def _minutes(value: float, interval: tuple[float, float]) -> str:
    low, high = map(_plain, interval)
    return f"{_plain(value)} [{low}, {high}]"


def _plain(minutes: float) -> str:
    if math.isnan(minutes):
        return "-"
    return f"over {END:.0f}" if math.isinf(minutes) else f"{minutes:.1f}".removesuffix(".0")


def _signed(minutes: float) -> str:
    return "-" if math.isnan(minutes) else f"{minutes:+.1f}"


def draw(arms: Arms) -> Figure:
    """Draws the share of recovered robots against time: own ideas, and a share of random ones."""
    figure, axes = style.canvas(3.4, 1, 2, sharey=True)
    for axis, ideas in zip(axes[0], ("own", "random"), strict=True):
        shown = [n for n in arms if n.startswith(_SHOWN) and ideas in n.split("-")]
        shown += [n for n in (NEWBORN, FROZEN) if n in arms]
        ends = {}
        for number, name in enumerate(shown):
            control = name in (NEWBORN, FROZEN)
            shade = style.INK if control else style.PALETTE[number % len(style.PALETTE)]
            times, share = _recovered(arms[name])
            axis.step(times, share, "--" if control else "-", where="post", color=shade)
            ends[name.removeprefix("trained-").replace(f"-{ideas}", "")] = share[-1], shade
        style.label_ends(axis, END, ends)
        axis.set(
            title="All ideas its own" if ideas == "own" else "A third random",
            xlabel="minutes after the change",
            xlim=(0, 1.45 * END),
            ylim=(-0.02, 1.02),
        )
        axis.set_xticks(np.arange(0, END + 1, 60))
    axes[0, 0].set_ylabel("recovered")
    style.in_per_cent(axes[0, 0].yaxis)
    return figure


def _recovered(arm: Recovery) -> tuple[np.ndarray, Sequence[float]]:
    """Returns times, and the share of recovered robots from each of them on."""
    if not len(arm.durations):
        return np.array([0.0, END]), [0.0, 0.0]
    curve = kaplan_meier(arm.durations)
    times = np.concatenate([[0.0], curve.times, [END]])
    at_once = float(1 - curve.share[0]) if curve.times[0] == 0 else 0.0
    return times, [at_once, *(1 - curve.share), float(1 - curve.share[-1])]
