"""The process as Gymnasium and PettingZoo environments; importing it registers their ids.

    import agent.envs, gymnasium
    env = gymnasium.make("MiniRobots/SingleA-v0")

`MiniRobots/SingleA-v0` and `SingleB-v0` are scenarios 1a and 1b on the grid,
`MiniRobots/CoSim-v0` is 1a in the full co-simulation; `gymnasium.make_vec` makes many that are
stepped together. `MiniRobots/Pair-v0` is for `make_vec` alone: scenario 2, or with `scenario=` one
of any number of robots, every robot a row. `parallel_env` makes a PettingZoo environment for pairs
and more, `parallel_vector_env` many of them. The version in an id rises with any change of a
reading.
"""

import gymnasium

from agent.envs.single import FlattenState, NavigationEnv, parallel_env, parallel_vector_env

__all__ = ["FlattenState", "NavigationEnv", "parallel_env", "parallel_vector_env"]

for _name, _scenario in (("SingleA", "1a"), ("SingleB", "1b")):
    gymnasium.register(
        f"MiniRobots/{_name}-v0",
        entry_point="agent.envs:NavigationEnv",
        vector_entry_point="agent.envs.vector:NavigationVectorEnv",
        kwargs={"scenario": _scenario},
    )
gymnasium.register(
    "MiniRobots/CoSim-v0",
    entry_point="agent.envs.single:cosim_env",
    vector_entry_point="agent.envs.cosim_vector:CoSimVectorEnv",
    kwargs={"scenario": "1a"},
)
gymnasium.register(
    "MiniRobots/Pair-v0",
    entry_point="agent.envs:NavigationEnv",  # which refuses, and names `parallel_env`
    vector_entry_point="agent.envs.vector:RobotsVectorEnv",
    kwargs={"scenario": "2"},
)
