"""PPO in a single file, in the style of CleanRL, that learns to drive a robot to random targets.

    uv run --with torch python docs/examples/cleanrl_drive.py --minutes 8 --out drive.pt
    uv run --with torch python docs/examples/cleanrl_drive.py --simulate drive.pt

Everything between the environments and the saved weights is in this file, to be changed. Rows of
the environments begin again in the step after their end (next-step autoreset): that step, in which
actions have no effect, is left out of what is learnt from.
"""

import argparse
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import minirobots as mr
from agent.envs.drive import DrivePolicy

ROWS, STEPS, EPOCHS, BATCH = 16, 128, 10, 256
GAMMA, LAMBDA, CLIP, RATE = 0.98, 0.95, 0.2, 1e-3
INTERVAL_S = 0.5


class Network(nn.Module):
    """Mean and logarithm of the deviation of actions, and value of observations."""

    def __init__(self, seen, actions):
        super().__init__()

        def layers(out, gain):
            last = nn.Linear(64, out)
            nn.init.orthogonal_(last.weight, gain)
            return nn.Sequential(nn.Linear(seen, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), last)

        self.mean, self.value = layers(actions, 0.01), layers(1, 1.0)
        self.deviation = nn.Parameter(torch.zeros(actions))

    def distribution(self, seen):
        return Normal(self.mean(seen), self.deviation.exp())


def advantages(rewards, values, ended, cut, last):
    """Generalised advantage estimates; a cut episode is worth the value of where it is."""
    estimates, following = torch.zeros_like(rewards), torch.zeros_like(last)
    for k in reversed(range(len(rewards))):
        after = values[k + 1] if k + 1 < len(values) else last
        going_on = 1.0 - ended[k]
        delta = rewards[k] + GAMMA * after * going_on - values[k]
        following = delta + GAMMA * LAMBDA * going_on * (1.0 - cut[k]) * following
        estimates[k] = following
    return estimates


def train(path, minutes, seed=0):
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    env = gymnasium.make_vec("MiniRobots/Drive-v0", num_envs=ROWS, control_interval=INTERVAL_S)
    network = Network(env.single_observation_space.shape[0], env.single_action_space.shape[0])
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE, eps=1e-5)
    seen = torch.as_tensor(env.reset(seed=seed)[0])
    fresh = torch.ones(ROWS)  # 0 in the step in which a row begins again
    ends, end_s = [], time.process_time() + 60.0 * minutes
    while time.process_time() < end_s:
        kept = {
            name: []
            for name in ("seen", "action", "said", "value", "reward", "ended", "cut", "fresh")
        }
        for _ in range(STEPS):
            with torch.no_grad():
                distribution = network.distribution(seen)
                action, value = distribution.sample(), network.value(seen).squeeze(-1)
            after, reward, ended, cut, infos = env.step(action.numpy())
            now = {
                "seen": seen,
                "action": action,
                "said": distribution.log_prob(action).sum(-1),
                "value": value,
                "reward": torch.as_tensor(reward, dtype=torch.float32),
                "ended": torch.as_tensor(ended, dtype=torch.float32),
                "cut": torch.as_tensor(cut, dtype=torch.float32),
                "fresh": fresh,
            }
            for name, tensor in now.items():
                kept[name].append(tensor)
            done = ended | cut
            ends += infos["is_success"][done].tolist()
            fresh, seen = 1.0 - torch.as_tensor(done, dtype=torch.float32), torch.as_tensor(after)
        rows = {name: torch.stack(tensors) for name, tensors in kept.items()}
        with torch.no_grad():
            last = network.value(seen).squeeze(-1)
        gain = advantages(rows["reward"], rows["value"], rows["ended"], rows["cut"], last)
        wanted = gain + rows["value"]
        learnt = rows["fresh"].flatten().bool()
        flat = [
            tensor.flatten(0, 1)[learnt]
            for tensor in (rows["seen"], rows["action"], rows["said"], gain, wanted)
        ]
        for _ in range(EPOCHS):
            for some in torch.randperm(len(flat[0])).split(BATCH):
                o, a, said, g, w = (tensor[some] for tensor in flat)
                ratio = (network.distribution(o).log_prob(a).sum(-1) - said).exp()
                g = (g - g.mean()) / (g.std() + 1e-8)
                policy = -torch.min(ratio * g, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * g).mean()
                error = (network.value(o).squeeze(-1) - w).pow(2).mean()
                optimizer.zero_grad()
                (policy + 0.5 * error).backward()
                nn.utils.clip_grad_norm_(network.parameters(), 0.5)
                optimizer.step()
        if ends:
            print(len(ends), "ends, of the last 100 succeeded", np.mean(ends[-100:]), flush=True)
    env.close()
    torch.save(network.state_dict(), path)


def policy(path):
    """The network as a policy of the co-simulation, also for `mr.evaluate`."""
    weights = torch.load(path, weights_only=True)
    network = Network(weights["mean.0.weight"].shape[1], len(weights["deviation"]))
    network.load_state_dict(weights)

    def predict(seen):
        with torch.no_grad():
            return network.mean(torch.as_tensor(seen)).numpy()

    return DrivePolicy(predict, control_interval=INTERVAL_S)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=8.0, help="processor time to train for")
    parser.add_argument("--out", type=Path, default=Path("drive.pt"))
    parser.add_argument("--simulate", type=Path, help="simulate and record an episode instead")
    arguments = parser.parse_args()
    if arguments.simulate:
        episode = mr.simulate("1a", policy(arguments.simulate))
        episode.save("drive.rrd")
        print(f"{episode.outcome} after {episode.time_s:.1f} s, recorded in drive.rrd")
    else:
        train(arguments.out, arguments.minutes)


if __name__ == "__main__":
    main()
