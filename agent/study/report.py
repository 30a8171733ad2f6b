"""Report of a study: its rows, as tables, files and a plot."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from agent.evaluation.rows import Row, columns_of, text_of
from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.base.errors import UserError
from cosim.base.storage import write_json, write_whole
from cosim.base.table import Columns, arrow_of, markdown, show, write_parquet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".json", ".md", ".parquet", ".png")


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """Rows of a study: policies in scenarios, with every combination of the axes."""

    table: ClassVar[Columns] = ()  # of a kind of reports; by default `columns_of` its rows
    brief: ClassVar[Columns] = ()  # in its place on a narrow console; by default fewer of these
    title: ClassVar[str | None] = None  # of the table on a terminal
    schema_version: int = 2
    seed: int | None = None  # of samples of starts and of what episodes draw; None on the grid
    axes: tuple[str, ...] = ()  # names of the options that vary
    rows: tuple[Row, ...]

    def __repr__(self) -> str:
        """Return what an interactive session shows: the table."""
        return self.to_markdown()

    @property
    def complete(self) -> bool:
        """Whether every row has all its episodes."""
        return all(row.episodes == row.planned for row in self.rows)

    def to_markdown(self) -> str:
        """Return the table as Markdown."""
        return markdown(self.table or columns_of(self.rows, self.axes), self.rows)

    def show(self) -> None:
        """Print the table, with fewer columns where the console is not wide enough for all."""
        columns = self.table or columns_of(self.rows, self.axes)
        layout = {"names": 2 + len(self.axes), "title": self.title}
        brief = self.brief or columns_of(self.rows, self.axes, brief=True)
        show(columns, self.rows, brief=brief, **layout)

    def to_arrow(self, *, episodes: bool = False) -> Any:
        """Return a `pyarrow.Table`: a row for each row, or for each episode."""
        return arrow_of(self._episodes() if episodes else [row.record() for row in self.rows])

    def to_pandas(self, *, episodes: bool = False) -> Any:
        """Return a `pandas.DataFrame`, see `to_arrow`."""
        try:
            return self.to_arrow(episodes=episodes).to_pandas()
        except ImportError as error:
            raise UserError(
                "pandas is not installed; run `pip install pandas`, or take to_arrow()"
            ) from error

    def plot(self, axis: str | None = None, quantity: str = "success") -> "Figure":
        """Draw a quantity over one axis, a panel for each scenario, or as a map over two axes.

        Args:
            axis: by default the first one; the scenario where no option varies; both where two do.
            quantity: such as "collision", "path_length_cm" or "energy_j"; bars are its 95 %
                interval, if it has one.
        """
        from agent.study.plot import QUANTITIES, draw_map, draw_measure  # noqa: PLC0415 - slow

        require_one_of("quantity", quantity, QUANTITIES)
        label = QUANTITIES[quantity][0]
        if axis is None and len(self.axes) == 2:
            panels = self._panels(lambda row: f"{row.policy}, scenario {row.scenario}")
            title = f"{label} over {' and '.join(self.axes)}"
            return draw_map(panels, self.axes, quantity=quantity, title=title)
        chosen = axis or (self.axes[0] if self.axes else "scenario")
        if chosen not in {*self.axes, "scenario"}:
            varying = ", ".join(self.axes) or "nothing"
            raise ConfigError(f"axis = {chosen!r} does not vary; in this study {varying} does")

        def series(row: Row) -> str:
            others = [f"{n} {text_of(row.options[n])}" for n in self.axes if n != chosen]
            return ", ".join([row.policy, *others])

        whole = chosen == "scenario"
        panels = self._panels(lambda row: "all scenarios" if whole else f"scenario {row.scenario}")
        bars = "; bars: 95 % intervals" if f"{quantity}_low" in Row.__struct_fields__ else ""
        how: dict[str, Any] = {
            "quantity": quantity,
            "axis": chosen,
            "title": f"{label} over {chosen}{bars}",
        }
        return draw_measure(panels, lambda row: row.labels()[chosen], series, **how)

    def _panels(self, name: Callable[[Row], str]) -> dict[str, list[Row]]:
        panels: dict[str, list[Row]] = {}
        for row in self.rows:
            panels.setdefault(name(row), []).append(row)
        return panels

    def write(self, path: str | Path, quantity: str = "success") -> None:
        """Write the table as Parquet, JSON or Markdown, or its `plot` as PNG, by the suffix."""
        path = Path(validate_argument("path", path, Path))
        rows = [row.record() for row in self.rows]
        match path.suffix:
            case ".json":
                more = [
                    {
                        "failures": row.failures,
                        "claim": row.claim,
                        "by_training": [part.record() for part in row.by_training],
                    }
                    for row in self.rows
                ]
                rows = [row | own for row, own in zip(rows, more, strict=True)]
                write_json(path, {"seed": self.seed, "axes": self.axes, "rows": rows})
            case ".md":
                write_whole(path, self.to_markdown() + "\n")
            case ".parquet":
                write_parquet(path, rows)
            case ".png":
                from cosim.base.plotting import save_figure  # noqa: PLC0415 - slow to import

                save_figure(self.plot(quantity=quantity), path, dpi=150)
            case _:
                raise ConfigError(f"{path}: its name must end in one of {', '.join(SUFFIXES)}")

    def write_episodes(self, path: str | Path) -> None:
        """Write all episodes to a Parquet file, a row each."""
        write_parquet(Path(path), self._episodes())

    def _episodes(self) -> list[dict[str, Any]]:
        names = ("digest", "training")
        return [
            row.labels()
            | {name: getattr(row, name) for name in names}
            | {"index": index}
            | msgspec.structs.asdict(result)
            for over in self.rows
            for row in over.by_training or (over,)
            for index, result in row.results.items()
        ]
