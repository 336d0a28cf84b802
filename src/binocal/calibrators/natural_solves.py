"""Who closes the kernel from an old rig: the agent and classical schedules, the schedules alone, or one of them."""

from __future__ import annotations

from binocal.calibrators.registry import WEIGHTS_SUFFIX
from binocal.errors import FormatError
from binocal.rl.agent_kind import AgentKind
from binocal.rl.epipolar_task import N_STEPS
from binocal.rl.policy import LearnedController, Policy, load_policy, shipped_policy
from binocal.solvers.portfolio import PORTFOLIO, Led

AGENT, ONE_SCHEDULE = "agent", "lm"
NATURAL_CALIBRATORS = ("drl", "portfolio", ONE_SCHEDULE)
"""The agent, the schedules and a search around the old rig; without the agent; one schedule and no search."""


def solves_of(calibrator: str) -> dict[str, Led]:
    """The solves that start at an old rig, the leader first; ``calibrator`` may be a file of weights.

    Raises:
        ValueError: No such calibrator; the text names those that are known.
        FormatError: The file of weights cannot be read, or is not of an agent for streets.
    """
    if calibrator.endswith(WEIGHTS_SUFFIX):
        policy = load_policy(calibrator)
        if policy.kind != AgentKind.DRL_STREETS:
            raise FormatError(
                calibrator, f"weights of {policy.kind}, which sees boards; train with --agent {AgentKind.DRL_STREETS}."
            )
        return {AGENT: led_by_agent(policy), **PORTFOLIO}
    if calibrator == "drl":
        return {AGENT: led_by_agent(shipped_policy(AgentKind.DRL_STREETS)), **PORTFOLIO}
    if calibrator == "portfolio":
        return dict(PORTFOLIO)
    if calibrator == ONE_SCHEDULE:
        return dict(list(PORTFOLIO.items())[:1])
    known = ", ".join(NATURAL_CALIBRATORS)
    raise ValueError(f"unknown calibrator {calibrator!r}; known: {known}, or a {WEIGHTS_SUFFIX} file")


def led_by_agent(policy: Policy) -> Led:
    """An agent's solve."""
    return Led(LearnedController(policy), N_STEPS)
