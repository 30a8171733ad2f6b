"""Profiles of a reproduction: the paper's amount, or a few minutes' worth."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from agent.training.settings import LearningConfig, MethodName
from cosim.model.params import TIMING
from cosim.model.scenario_file import PAPER

SEQUEL_EPISODES = 2_000_000  # of training; the sequel does not say its number


@dataclass(frozen=True)
class Profile:
    """Amounts of a reproduction; by default those of the paper and of the pages."""

    name: str
    # Independent training runs of every variant
    runs: int = 20  # Section V
    train_episodes: int = LearningConfig().episodes  # episodes of a training run
    greedy_points: int = LearningConfig().greedy_points  # evaluations during such a run
    # Episodes of the training, by method, of the policies that drive the co-simulated episodes; by
    # default the number of the method
    drive_episodes: Mapping[str, int] = field(default_factory=dict)
    # single_episodes, pair_episodes: co-simulated, recorded episodes of every scenario with paths
    # in Fig. 9 or 12, of one robot and of a pair: the paper draws many of one robot, few of a pair
    single_episodes: int = 6
    pair_episodes: int = 2
    # Simulated time after which such an episode ends as a time-out
    episode_limit_s: float = TIMING.episode_limit_s
    # transfer_scenarios, transfer_methods: scenarios and training methods of the table of success
    # in co-simulation
    transfer_scenarios: tuple[str, ...] = tuple(PAPER)
    transfer_methods: tuple[MethodName, ...] = ("moves", "paper")
    # transfer_trainings, transfer_episodes: trainings of each of them, episodes of each training
    transfer_trainings: int = 10
    transfer_episodes: int = 10

    def episodes_of(self, experiment: str) -> int:
        """Return the training episodes of a run of an experiment."""
        most = SEQUEL_EPISODES if experiment == "sequel" else self.train_episodes
        return min(self.train_episodes, most)


FULL = Profile("full")
# Episodes after which a policy reaches its targets; intervals take more than one run.
QUICK = Profile(
    name="quick",
    runs=2,
    train_episodes=500_000,
    greedy_points=10,
    drive_episodes={"paper": 1_000_000, "moves": 500_000},
    single_episodes=2,
    pair_episodes=1,
    transfer_scenarios=("1a", "2"),
    transfer_trainings=2,
    transfer_episodes=2,
)
