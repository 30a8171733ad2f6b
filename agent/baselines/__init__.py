"""Measure learners on the same boards, and what they cost: the table of docs/baselines.md."""

from typing import Literal, get_args

from agent.deep import NetworkAlgorithm
from agent.mdp.config import Objective

Table = Literal["paper", "double_q", "moves", "prompt", Objective]
Learner = Literal[Table, NetworkAlgorithm]
NETWORKS: tuple[NetworkAlgorithm, ...] = get_args(NetworkAlgorithm)
LEARNERS: tuple[Learner, ...] = get_args(Learner)
