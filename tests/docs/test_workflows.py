"""The workflows of the public CI: well formed, and they call what exists."""

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def load(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_every_job_runs_somewhere_and_calls_what_exists(path):
    workflow = load(path)
    assert workflow["name"] and workflow["permissions"] == {"contents": "read"}
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for job in workflow["jobs"].values():
        if "uses" in job:
            assert (ROOT / job["uses"]).is_file()
            continue
        assert job["runs-on"] and job["steps"]
        for step in job["steps"]:
            assert ("run" in step) != ("uses" in step)
            for target in re.findall(r"\bmake (\w+)", step.get("run", "")):
                assert target in targets
            for script in re.findall(r"\bpython (\S+\.py)", step.get("run", "")):
                assert (ROOT / script).is_file()
            for needed in job.get("needs", []) if isinstance(job.get("needs"), list) else [job.get("needs")]:
                assert needed is None or needed in workflow["jobs"]


def test_the_fast_tests_run_on_every_system_and_version_that_is_promised():
    matrix = load(ROOT / ".github" / "workflows" / "ci.yml")["jobs"]["fast-tests"]["strategy"]["matrix"]
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos", "windows"}
    classifiers = re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert matrix["python"] == classifiers


def test_a_release_publishes_without_a_secret():
    publish = load(ROOT / ".github" / "workflows" / "release.yml")["jobs"]["publish"]
    assert publish["permissions"] == {"id-token": "write"}
    assert "secrets" not in (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")


def test_what_is_committed_is_checked_before():
    hooks = {h["id"] for repo in load(ROOT / ".pre-commit-config.yaml")["repos"] for h in repo["hooks"]}
    assert {"ruff-check", "ruff-format", "check-added-large-files"} <= hooks
