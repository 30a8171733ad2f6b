"""The models that there are FMUs of: their folders of sources, and the standards of their FMUs.

A model's files are searched in its own folder first, then in those it shares with others.
"""

from pathlib import Path
from typing import Literal

Fmi = Literal["2", "3"]
Model = Literal["VibrationMotor", "VibrationMotors"]
STANDARDS: dict[Model, tuple[Fmi, ...]] = {
    "VibrationMotor": ("2", "3"),
    "VibrationMotors": ("3",),  # FMI 2.0 has no arrays
}
MODELS: tuple[Model, ...] = tuple(STANDARDS)
ROOT = Path(__file__).parent
_FOLDERS: dict[Model, tuple[str, ...]] = {
    "VibrationMotor": ("vibration_motor", "fmi"),
    "VibrationMotors": ("vibration_motors", "vibration_motor", "fmi"),
}


def folders(model: Model) -> list[Path]:
    """Folders of a model's files, its own first."""
    return [ROOT / name for name in _FOLDERS[model]]


def find(model: Model, name: str) -> Path | None:
    """A model's file of that name; None if it has none."""
    return next((f / name for f in folders(model) if (f / name).is_file()), None)


def read_text(model: Model, name: str) -> str:
    """Return the text of a model's file; raises FileNotFoundError."""
    if (path := find(model, name)) is None:
        raise FileNotFoundError(f"{model} has no {name}")
    return path.read_text("utf-8")
