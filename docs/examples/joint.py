"""Q-learning of robots that see their partner's cell, as a method of one's own.

Each learns the values of its own actions in the joint state; it does not know which action the
partner will take.
"""

from agent.mdp.config import ProcessConfig
from agent.training.methods import learner
from agent.training.settings import LearningConfig


def with_partner(_):
    """The cells of both robots, and a larger learning rate for some 100 times as many states."""
    return ProcessConfig(features=("x", "y", "p")), LearningConfig(eta=0.1)


@learner(ahead=False, settings=with_partner)
def joint(q, s, a, reward, discount, s_next, a_next, eta, coin):
    """Q-learning in the joint state: each robot sees the cell of the other."""
    q[0, s, a] += eta * (reward + discount * q[0, s_next, a_next] - q[0, s, a])
