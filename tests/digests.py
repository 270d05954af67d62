"""Runs as an earlier version left them: without digests."""

import json


def forget_digests(directory):
    """Makes a run look as if an earlier version, which recorded no digests, had written it."""
    path = directory / "experiment.json"
    content = json.loads(path.read_bytes())
    del content["files"], content["digest"]
    path.write_text(json.dumps(content, indent=2) + "\n")
