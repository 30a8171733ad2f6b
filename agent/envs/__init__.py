"""The process as Gymnasium and PettingZoo environments; importing it registers their ids.

    import agent.envs, gymnasium
    env = gymnasium.make("MiniRobots/SingleA-v0")

`MiniRobots/SingleA-v0` and `SingleB-v0` are scenarios 1a and 1b on the grid,
`MiniRobots/CoSim-v0` is 1a in the full co-simulation; `gymnasium.make_vec` makes many that are
stepped together. `parallel_env` makes a PettingZoo environment for pairs and more. The version in
an id rises with any change of a reading.
"""

import gymnasium

from agent.envs.single import FlattenState, NavigationEnv, parallel_env

__all__ = ["FlattenState", "NavigationEnv", "parallel_env"]

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
