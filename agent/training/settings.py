"""Settings files of the agent: TOML tables `[process]` and `[learning]`, checked field by field."""

from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import msgspec

from agent.process.readings import ProcessConfig
from agent.training.learning import LearningConfig
from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_toml

_Config = TypeVar("_Config", ProcessConfig, LearningConfig)


class SettingsError(UserError):
    """A settings file that cannot be used; the message names the field."""


_FILE = Kind("settings file", "check the path", SettingsError)


def read_settings(path: Path) -> tuple[ProcessConfig, LearningConfig]:
    """Decision process and learning configuration of a TOML file; what it leaves out is default.

    Raises:
        SettingsError: the file is missing, no TOML, or a field is unknown or wrong.
    """
    content = read_toml(path, _FILE)
    unknown = set(content) - {"process", "learning"}
    if unknown:
        raise SettingsError(f"{path}: unknown table '{min(unknown)}'; use [process] and [learning]")
    process = _convert(path, "process", content.get("process", {}), ProcessConfig)
    return process, _convert(path, "learning", content.get("learning", {}), LearningConfig)


def _convert(path: Path, table: str, content: Any, config: type[_Config]) -> _Config:
    known = {field.name for field in fields(config)}
    for name in content:
        if name not in known:
            raise SettingsError(
                f"{path}: unknown field {table}.{name}; choose one of {', '.join(sorted(known))}"
            )
    try:
        return msgspec.convert(content, config)
    except msgspec.ValidationError as error:
        problem, _, where = str(error).partition(" - at ")
        field = where.strip("`").replace("$", table)
        raise SettingsError(f"{path}: {field or table}: {problem.replace('`', '')}") from error
    except UserError as error:
        raise SettingsError(f"{path}: {error}") from error


Method = Literal["moves", "paper", "slip"]
METHODS: tuple[Method, ...] = get_args(Method)
BEST: Method = "moves"
