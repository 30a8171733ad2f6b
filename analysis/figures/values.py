"""What one robot has learnt: the value, the direction and the visits of every cell."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from agent.mdp.greedy import PolicyMap
from agent.training.policy import load_policy
from agent.training.runs import policy_paths
from analysis.figures.style import WIDTH_IN, Drawing, figure
from analysis.reading.results import RESULTS
from cosim.model.scenario import Scenario

SCENARIO = "1b"  # in which a robot starts on all sides


@figure(
    "values",
    "What one robot has learnt in scenario 1b, after the first run of Fig. 8: the largest "
    "action value of every cell with its direction (left), and how often the robot was there "
    "(right); red: target",
    inputs=("fig08",),
)
def make(results: Path) -> Drawing:
    """Draw the policy of the first run of Fig. 8 in scenario 1b."""
    policy = load_policy(policy_paths(RESULTS["fig08"].location(results) / SCENARIO)[0])
    (learnt,) = policy.maps()
    known = learnt.value[learnt.visits > 0]
    low, high = float(known.min()), float(known.max())
    most, least = int(learnt.visits.max()), int(learnt.visits[learnt.visits > 0].min())
    ours = (
        f"After {policy.episodes:,} episodes values are {low:.1f} to {high:.1f}. Cells were "
        f"visited {least:,} to {most:,} times; values of cells with few visits are too low."
    )
    numbers = {"values": [low, high], "visits": [least, most]}
    return Drawing(draw(learnt, policy.config.scenario), (ours,), numbers)


def draw(learnt: PolicyMap, scenario: Scenario) -> Figure:
    """Draw values with the best directions, and how often cells were visited."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH_IN, 3.7))
    seen = learnt.visits > 0
    angle = np.deg2rad(45.0 * learnt.action)
    arrows = np.where(seen, np.cos(angle), np.nan), np.where(seen, np.sin(angle), np.nan)
    columns, rows = np.indices(learnt.action.shape)
    how: Any = {"pivot": "mid", "angles": "xy", "scale_units": "xy", "scale": 1.25}
    left.quiver(columns, rows, *arrows, **how, width=0.004, headwidth=4)
    shown = np.where(seen, learnt.value, np.nan), np.log10(np.where(seen, learnt.visits, np.nan))
    for axes, values, title, colours in (
        (left, shown[0], "value, and best direction", "YlGn"),
        (right, shown[1], "visits, power of ten", "Blues"),
    ):
        image = axes.imshow(values.T, origin="lower", cmap=colours)
        figure.colorbar(image, ax=axes, shrink=0.8)
        for target in scenario.targets:
            axes.plot(*target, "s", color="red", markersize=4)
        axes.grid(visible=False)
        axes.set_title(title, loc="left")
        axes.set(xlabel="column", ylabel="row")
    return figure
