"""The list of the runs and pages that are kept in docs/results."""

from __future__ import annotations

from pathlib import Path

from tables import table

from musebot.protocols.agents.names import short_name
from musebot.protocols.pages.markdown import particulars
from musebot.protocols.runs.run_files import read_measured, read_run


def pages(docs: Path) -> dict[str, str]:
    """Returns the list's page."""
    results = docs / "results"
    runs = [_run(path.parent, results) for path in sorted(results.rglob("experiment.json"))]
    studies = sorted(
        path
        for path in results.rglob("*.md")
        if path.name != "tables.md" and not path.name.startswith("compare-")
    )
    listed = "".join(
        f"- [{path.parent.name}](../results/{path.relative_to(results)})\n" for path in studies
    )
    return {
        "runs.md": f"""# Kept runs

Every run in `docs/results`, from its own files. A link opens its tables;
[methods.md](../methods.md#files-and-commands) explains the files.
`musebot tables docs/results/NAME` prints the tables again,
`musebot film docs/results/NAME --task TASK --output FILE.mp4` films a robot.
*No brains*: kept without them; a robot can be filmed in its life (`--minute`), not in a test.
The column *experiment* names all that differs from the
defaults: brain `paper`, body `mujoco`.

{table(("run", "experiment", "seed:", "robots"), runs)}
## Pages of studies

{listed}"""
    }


def _run(folder: Path, results: Path) -> tuple[str, ...]:
    run, name = read_run(folder, networks=False), str(folder.relative_to(results))
    experiment = run.experiment
    brains = all(lives.after for lives in read_measured(folder, experiment).values())
    shown = name if brains else f"{name} (no brains)"
    links = (
        [f"[{shown}](../results/{name}/tables.md)"] if (folder / "tables.md").exists() else [shown]
    )
    links += [
        f"[{path.stem.replace('compare-', 'compared with ')}](../results/{name}/{path.name})"
        for path in sorted(folder.glob("compare-*.md"))
    ]
    counts: dict[str, list[str]] = {}
    for condition in run.conditions():
        robots = f"{len(run.robots(condition))} {short_name(condition.proposer)}"
        counts.setdefault(condition.life, []).append(robots)
    robots = "; ".join(f"{task}: {', '.join(parts)}" for task, parts in counts.items())
    return (
        "<br>".join(links),
        ", ".join(particulars(experiment)),
        str(experiment.seed),
        robots,
    )
