"""`python -m analysis.fig08`: Fig. 8, learning curves of one robot (scenarios 1a, 1b)."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from analysis.learning import draw_learning_curves, load_experiment, summary
from analysis.style import save, use_style
from cosim.errors import run_command


@dataclass(frozen=True)
class Fig08:
    """Draw Fig. 8: learning curves of one robot, scenarios 1a and 1b.

    The upper row is the paper's: mean over the last 100 episodes, exploring. The lower row is the
    greedy policy at that time, evaluated exactly from every start.
    """

    results: Path = Path("runs/experiments/fig08")
    """Folder made by `python -m agent.experiments fig08 --out …`."""
    out: Path = Path("figures/fig08.png")
    """Figure to write; PNG and PDF are written beside each other."""


def main() -> None:
    """Command line."""
    options = tyro.cli(Fig08, prog="python -m analysis.fig08")
    use_style()
    variants = load_experiment(options.results, "fig08")
    figure = draw_learning_curves(variants)
    print("\n".join(summary(variants)))
    print("figure: " + ", ".join(str(path) for path in save(figure, options.out)))


if __name__ == "__main__":
    run_command(main)
