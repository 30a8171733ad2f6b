"""`python -m analysis.fig10`: Fig. 10, what the coefficient c of Eq. (12) changes."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from analysis.learning import draw_learning_curves, load_experiment, summary
from analysis.style import save, use_style
from cosim.errors import run_command


@dataclass(frozen=True)
class Fig10:
    """Draw Fig. 10: learning curves of a pair for several coefficients c of Eq. (12).

    The upper row is the paper's: mean over the last 100 episodes, exploring. The lower row is the
    greedy policy at that time, evaluated exactly from every start.
    """

    results: Path = Path("runs/experiments/fig10")
    """Folder made by `python -m agent.experiments fig10 --out …`."""
    out: Path = Path("figures/fig10.png")
    """Figure to write; PNG and PDF are written beside each other."""


def main() -> None:
    """Command line."""
    options = tyro.cli(Fig10, prog="python -m analysis.fig10")
    use_style()
    variants = load_experiment(options.results, "fig10")
    figure = draw_learning_curves(variants)
    print("\n".join(summary(variants)))
    print("figure: " + ", ".join(str(path) for path in save(figure, options.out)))


if __name__ == "__main__":
    run_command(main)
