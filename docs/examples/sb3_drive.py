"""Train Stable-Baselines3's PPO to drive a robot to random targets, and evaluate it.

    uv run --with stable-baselines3 python docs/examples/sb3_drive.py --minutes 15 --out drive.zip
    uv run --with stable-baselines3 python docs/examples/sb3_drive.py --evaluate drive.zip
    uv run --with stable-baselines3 python docs/examples/sb3_drive.py --simulate drive.zip

The last one drives from a start of scenario 1a to its target, and keeps a recording. Training
continues with a file that exists.
"""

import argparse
import time
from collections import Counter
from pathlib import Path

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

import agent.envs
import minirobots as mr
from agent.envs.drive import DrivePolicy
from cosim.model.outcome import BY_RANK

OPTIONS = {"control_interval": 0.5}


class Rows(VecEnv):
    """Stable-Baselines3's view of a vector environment, whose rows are reset when they end."""

    def __init__(self, env):
        self.env, self.render_mode = env, None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self):
        return self.env.reset(seed=self._seeds[0])[0]

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        seen, rewards, terminated, truncated, infos = self.env.step(self.actions)
        done = terminated | truncated
        ends = [{"is_success": bool(success)} for success in infos["is_success"]]
        if done.any():
            begun, _ = self.env.reset(options={"reset_mask": done})
            for row in np.flatnonzero(done):
                ends[row] |= {"terminal_observation": seen[row]}
                ends[row] |= {"TimeLimit.truncated": bool(truncated[row])}
            seen = np.where(done[:, None], begun, seen)
        return seen, rewards, done, ends

    def close(self):
        self.env.close()

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs

    def env_method(self, name, *args, indices=None, **kwargs):
        return [getattr(self.env, name)(*args, **kwargs)] * self.num_envs

    def get_attr(self, name, indices=None):
        return [getattr(self.env, name)] * self.num_envs

    def set_attr(self, name, value, indices=None):
        setattr(self.env, name, value)


class Until(BaseCallback):
    """Stop after some processor time, and print the share of episodes that succeeded."""

    def __init__(self, seconds):
        super().__init__()
        self.end, self.ends = time.process_time() + seconds, []

    def _on_step(self):
        for info in self.locals["infos"]:
            if "terminal_observation" in info:
                self.ends.append(info["is_success"])
                if len(self.ends) % 100 == 0:
                    share = np.mean(self.ends[-100:])
                    print(self.num_timesteps, "steps", len(self.ends), "ends", share, flush=True)
        return time.process_time() < self.end


def make(count, **options):
    return gymnasium.make_vec("MiniRobots/Drive-v0", num_envs=count, **OPTIONS, **options)


def train(path, minutes, options):
    env = Rows(make(16, **options))
    env.seed(0)
    if path.exists():
        model = PPO.load(path, env=env)
    else:
        settings = {"n_steps": 128, "batch_size": 256, "n_epochs": 10, "gamma": 0.98}
        model = PPO("MlpPolicy", env, learning_rate=1e-3, seed=0, device="cpu", **settings)
    try:
        model.learn(10**9, callback=Until(60.0 * minutes), reset_num_timesteps=False)
    finally:  # also after Ctrl-C
        model.save(path)


def evaluate(path, episodes, options):
    """Number of episodes by outcome, each with its own seed."""
    model = PPO.load(path, device="cpu")
    env = make(episodes, **options)
    seen, _ = env.reset(seed=1000)
    outcomes, ended = np.zeros(episodes, dtype=int), np.zeros(episodes, dtype=bool)
    while not ended.all():
        actions, _ = model.predict(seen, deterministic=True)
        seen, _, terminated, truncated, infos = env.step(actions)
        outcomes[~ended] = infos["outcome"][~ended]
        ended |= terminated | truncated
    env.close()
    return Counter(BY_RANK[outcome].value for outcome in outcomes)


def driver(path):
    """The policy as one that drives in any scenario, also for `mr.evaluate`."""
    model = PPO.load(path, device="cpu")
    return DrivePolicy(lambda seen: model.predict(seen, deterministic=True)[0], **OPTIONS)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=15.0, help="processor time to train for")
    parser.add_argument("--out", type=Path, default=Path("drive.zip"))
    parser.add_argument("--evaluate", type=Path, help="evaluate this file instead")
    parser.add_argument("--simulate", type=Path, help="simulate and record an episode instead")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--time-limit", type=float, default=120.0, help="of an episode, in s")
    parser.add_argument("--worlds", action="store_true", help="draw the world of every episode")
    arguments = parser.parse_args()
    options = {"worlds": agent.envs.ROBUST_WORLDS} if arguments.worlds else {}
    options["time_limit"] = arguments.time_limit
    if arguments.evaluate:
        print(dict(evaluate(arguments.evaluate, arguments.episodes, options)))
    elif arguments.simulate:
        episode = mr.simulate("1a", driver(arguments.simulate))
        episode.save("drive.rrd")
        print(f"{episode.outcome} after {episode.time_s:.1f} s, recorded in drive.rrd")
    else:
        train(arguments.out, arguments.minutes, options)


if __name__ == "__main__":
    main()
