"""What a result was made with: versions, commit, processor."""

import os
import shutil
import subprocess

import numpy as np
import pytest
import scipy

from musebot import __version__
from musebot.protocols.lives import provenance


def test_versions_and_processor_are_named():
    made_with = provenance.machine()
    assert made_with["musebot"] == __version__
    assert made_with["numpy"] == np.__version__
    assert made_with["cores"] == os.cpu_count()
    assert made_with["scipy"] == scipy.__version__
    assert {"python", "mujoco", "dm-control", "torch", "cpu", "platform"} < made_with.keys()


@pytest.mark.parametrize("there", [True, False])
def test_an_optional_package_that_computes_results_is_named_if_it_is_installed(there, monkeypatch):
    def version(name, known=provenance.metadata.version):
        if name == "cmaes" and not there:
            raise provenance.metadata.PackageNotFoundError
        return "9.8" if name == "cmaes" else known(name)

    monkeypatch.setattr(provenance.metadata, "version", version)
    assert provenance.machine().get("cmaes") == ("9.8" if there else None)


def git(folder, *words):
    identity = ["-c", "user.name=somebody", "-c", "user.email=nobody@example.org"]
    command = ["git", *identity, *words]
    alone = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}  # no user's settings
    done = subprocess.run(
        command, cwd=folder, env=os.environ | alone, check=True, capture_output=True, text=True
    )
    return done.stdout


@pytest.mark.skipif(not shutil.which("git"), reason="there is no Git here")
def test_the_commit_is_this_packages_and_says_whether_files_were_changed(tmp_path, monkeypatch):
    def commit(root):
        path = root / "protocols" / "experiment" / "provenance.py"
        monkeypatch.setattr(provenance, "__file__", str(path))
        return provenance._commit.__wrapped__()

    git(tmp_path, "init")
    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "--message", "one")
    head = git(tmp_path, "rev-parse", "HEAD").strip()
    assert commit(tmp_path) == head[:12]
    (tmp_path / "file").write_text("two")
    assert commit(tmp_path) == f"{head[:12]}-dirty"
    # Installed inside somebody else's repository: its commit is not ours.
    (tmp_path / "packages" / "musebot").mkdir(parents=True)
    assert commit(tmp_path / "packages" / "musebot") is None


def test_the_root_is_the_folder_of_the_package():
    # `_commit` asks Git there: a move of the module must not change it.
    root = provenance.Path(provenance.__file__).parents[2]
    assert (root / "__main__.py").exists() and (root / "protocols").is_dir()
