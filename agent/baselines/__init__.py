"""Measure learners on the same boards, and what they cost: the table of docs/baselines.md."""

from typing import Literal, get_args

from agent.deep import NetworkAlgorithm

Table = Literal["paper", "double_q", "moves", "pair", "shortest", "fastest"]
Learner = Literal[Table, NetworkAlgorithm]
NETWORKS: tuple[NetworkAlgorithm, ...] = get_args(NetworkAlgorithm)
LEARNERS: tuple[Learner, ...] = get_args(Learner)
