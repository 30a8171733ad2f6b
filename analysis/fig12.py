"""`python -m analysis.fig12`: Fig. 12, ways of pairs after learning (scenarios 2, 3, 4)."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from analysis.learning import first_policy, load_experiment
from analysis.style import save, use_style
from analysis.trajectories import draw_examples, examples
from cosim.errors import run_command


@dataclass(frozen=True)
class Fig12:
    """Draw Fig. 12: episodes of the first run's policies of scenarios 2, 3 and 4, one a board."""

    results: Path = Path("runs/experiments/fig11")
    """Folder made by `python -m agent.experiments fig11 --out …`."""
    episodes: int = 2
    """Episodes per scenario."""
    seed: int = 0
    """Seed that the start cells are drawn with."""
    out: Path = Path("figures/fig12.png")
    """Figure to write; PNG and PDF are written beside each other."""


def main() -> None:
    """Command line."""
    options = tyro.cli(Fig12, prog="python -m analysis.fig12")
    use_style()
    policies = [first_policy(v) for v in load_experiment(options.results, "fig11").values()]
    found = [(p, examples(p, options.episodes, options.seed)) for p in policies]
    boards = [[(p, [row[k]]) for p, row in found] for k in range(options.episodes)]
    figure = draw_examples(boards)
    print("figure: " + ", ".join(str(path) for path in save(figure, options.out)))


if __name__ == "__main__":
    run_command(main)
