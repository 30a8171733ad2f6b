"""`python -m analysis.fig09`: Fig. 9, ways of one robot after learning (scenarios 1a, 1b)."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from analysis.learning import first_policy, load_experiment
from analysis.style import save, use_style
from analysis.trajectories import draw_examples, examples
from cosim.errors import run_command


@dataclass(frozen=True)
class Fig09:
    """Draw Fig. 9: ways of the first run's policies of scenarios 1a and 1b from drawn starts."""

    results: Path = Path("runs/experiments/fig08")
    """Folder made by `python -m agent.experiments fig08 --out …`."""
    ways: int = 10
    """Ways per board."""
    seed: int = 0
    """Seed that the start cells are drawn with."""
    out: Path = Path("figures/fig09.png")
    """Figure to write; PNG and PDF are written beside each other."""


def main() -> None:
    """Command line."""
    options = tyro.cli(Fig09, prog="python -m analysis.fig09")
    use_style()
    policies = [first_policy(v) for v in load_experiment(options.results, "fig08").values()]
    figure = draw_examples([[(p, examples(p, options.ways, options.seed)) for p in policies]])
    print("figure: " + ", ".join(str(path) for path in save(figure, options.out)))


if __name__ == "__main__":
    run_command(main)
