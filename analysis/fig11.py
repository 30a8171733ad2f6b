"""`python -m analysis.fig11`: Fig. 11, pairs of robots (scenarios 2, 3, 4)."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from analysis.learning import draw_learning_curves, load_experiment, summary
from analysis.style import save, use_style
from cosim.errors import run_command


@dataclass(frozen=True)
class Fig11:
    """Draw Fig. 11: learning curves of pairs, scenarios 2, 3 and 4.

    The upper row is the paper's: mean over the last 100 episodes, exploring. The lower row is the
    greedy policy at that time, evaluated exactly from every start.
    """

    results: Path = Path("runs/experiments/fig11")
    """Folder made by `python -m agent.experiments fig11 --out …`."""
    out: Path = Path("figures/fig11.png")
    """Figure to write; PNG and PDF are written beside each other."""


def main() -> None:
    """Command line."""
    options = tyro.cli(Fig11, prog="python -m analysis.fig11")
    use_style()
    variants = load_experiment(options.results, "fig11")
    figure = draw_learning_curves(variants)
    print("\n".join(summary(variants)))
    print("figure: " + ", ".join(str(path) for path in save(figure, options.out)))


if __name__ == "__main__":
    run_command(main)
