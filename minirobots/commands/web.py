"""A page in which a policy's robots drive, without installing anything."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosim.base.progress import Progress, under_way
from cosim.model.config import ConfigError
from minirobots.options import File, ScenarioName, Seed, Simulating


class Web(Simulating):
    """Write one HTML file that plays the episodes of a policy in a browser, without network.

    Motors, bodies, steering and policies run in it as C, compiled to WebAssembly (docs/web.md lists
    what is the same as in the co-simulation and what is refused). The file opens from disk.
    """

    scenario: ScenarioName = "4"
    policy: File
    """Policy (policy.npz) that `minirobots run` or `minirobots deep` writes, but for the method
    planned."""
    out: File
    """Page to write (.html)."""
    worlds: tuple[str, ...] = ()
    """More worlds to choose from in the page: rough, or world files (.toml) with the obstacles of
    the scenario. Set points are calibrated for each."""
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.physics.motor_fmu:
            raise ConfigError("a page has the built-in motor only; leave out --motor-fmu")


def run(options: Web, progress: Progress) -> Iterator[Any]:
    """Load the policy, compile the episode, write the page and print where it is."""
    from agent.policies import method_name
    from agent.web.build import cached_wasm
    from agent.web.packing import load_page_policy, require_playable
    from agent.web.page import write_page
    from cosim.base.storage import named
    from cosim.model.scenario_file import ROUGH, find_in_world
    from cosim.simulation.options import resolve

    out = named(options.out, ".html")
    scenario, world = find_in_world(options.scenario, options.physics.world)
    policy = load_page_policy(options.policy, scenario)
    require_playable(scenario, options.physics.config(world))  # before anything is measured
    files = [ROUGH if name == "rough" else Path(name) for name in options.worlds]
    if len({"own", *(file.stem for file in files)}) <= len(files):
        raise ConfigError(
            f"--worlds {' '.join(options.worlds)}: two have one name, or one is called own, as the "
            "page's first world is; rename a file"
        )
    for file in files:
        other, world = find_in_world(options.scenario, file)
        require_playable(other, options.physics.config(world))
        if other != scenario:
            raise ConfigError(f"{file} has other obstacles; write another page for that world")
    with under_way(progress, "compiling the episode"):
        wasm = cached_wasm()
    scenario, config, _ = resolve(options.physics, options.scenario, progress)
    worlds = {
        file.stem: resolve(options.physics, options.scenario, progress, world=file).config
        for file in files
    }
    about = (
        f"The policy is by the method {method_name(policy)}. Motors, bodies and steering are the "
        "C of the FMUs and the firmware, compiled to WebAssembly. An episode is the first one of "
        "`minirobots run --portable` with its seed and the options of the page, in every bit. "
        "Another friction changes the floor; set points stay those calibrated for "
        f"{config.robot.mu:g}."
    )
    write_page(out, policy, scenario, config, wasm, options.seed, about, worlds)
    size = out.stat().st_size
    yield {"page": str(out), "bytes": size}
    print(f"page in {out} ({size / 1e6:.2f} MB); open it in a browser")
