"""Print a machine file with four motors and four feet at random places.

`uv run python docs/examples/draw_machine.py 1 > drawn.toml`
"""

import math
import sys

import numpy as np


def machine(seed: int) -> str:
    """Return the file's text: motors and feet near the corners of two squares."""
    rng = np.random.default_rng(seed)
    lines = [f'source = "drawn at random with seed {seed}"']
    for k in range(4):
        angle = math.pi / 2.0 * k + rng.uniform(-0.3, 0.3)
        radius = rng.uniform(0.014, 0.021)
        shaft = angle + rng.uniform(-0.3, 0.3)
        place = [radius * math.cos(angle), radius * math.sin(angle), 0.003]
        axis = [math.cos(shaft), math.sin(shaft), 0.0]
        lines += ["", "[[motor]]", f"place_m = {numbers(place)}", f"axis = {numbers(axis)}"]
    for k in range(4):
        angle = math.pi / 4.0 + math.pi / 2.0 * k + rng.uniform(-0.2, 0.2)
        radius = rng.uniform(0.019, 0.0235)
        place = [radius * math.cos(angle), radius * math.sin(angle)]
        lines += ["", "[[foot]]", f"place_m = {numbers(place)}"]
    return "\n".join(lines)


def numbers(values: list[float]) -> str:
    """Return numbers as TOML has them, to a tenth of a millimetre."""
    return f"[{', '.join(f'{value:.4f}' for value in values)}]"


if __name__ == "__main__":
    print(machine(int(sys.argv[1])))
