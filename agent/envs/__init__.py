"""The process as Gymnasium and PettingZoo environments; importing it registers their ids.

    import agent.envs, gymnasium
    env = gymnasium.make("MiniRobots/SingleA-v0")

`MiniRobots/SingleA-v0` and `SingleB-v0` are scenarios 1a and 1b on the grid,
`MiniRobots/CoSim-v0` is 1a in the full co-simulation; `gymnasium.make_vec` makes many that are
stepped together. `MiniRobots/Pair-v0` and `MiniRobots/CoSimPair-v0` are for `make_vec` alone:
scenario 2, or with `scenario=` one of any number of robots, every robot a row. `parallel_env` makes
a PettingZoo environment for pairs and more. The version in an id rises with any change of an
interpretation.
"""

import gymnasium

from agent.envs.navigation import NavigationEnv, NavigationParallelEnv
from agent.moves.worlds import RANGES as ROBUST_WORLDS
from agent.moves.worlds import WorldRange

__all__ = ["ROBUST_WORLDS", "NavigationEnv", "WorldRange", "parallel_env"]

parallel_env = NavigationParallelEnv

for _name, _scenario, _steps in (
    ("SingleA", "1a", 1000),
    ("SingleB", "1b", 1000),
    ("Pair", "2", 1000),  # alone it is refused
    ("CoSim", "1a", 300),
    ("CoSimPair", "2", 300),
):
    gymnasium.register(
        f"MiniRobots/{_name}-v0",
        entry_point="agent.envs:NavigationEnv",
        vector_entry_point="agent.envs.navigation:RobotsVectorEnv",
        kwargs={"scenario": _scenario} | ({"cosim": True} if _name.startswith("CoSim") else {}),
        max_episode_steps=_steps,
    )
gymnasium.register(
    "MiniRobots/Drive-v0",
    entry_point="agent.envs.drive:DriveEnv",
    vector_entry_point="agent.envs.drive:DriveVectorEnv",
    max_episode_steps=1200,
)
